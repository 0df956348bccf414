"""Export of a drive-test tool.

Some 70 sparse columns, SINR and RSRP in separate lines, notes at the end, height in the file's name.
"""

import re

from cellpilot.maps.sources.log_format import LogFormat, rsrp, rsrq, sinr

NOTE_MARKER = "exported measurements"
NOTE_PATH = re.compile(r"([A-Za-z]:)?[\\/]")


def _is_note(row: list[str]) -> bool:
    # Recognised by what it says, not where it stands: files get sorted, shuffled and joined.
    first = row[0].strip()
    return first.lower() == NOTE_MARKER or NOTE_PATH.match(first) is not None


DRIVE_TEST = LogFormat(
    name="drive-test export",
    signature=("Latitude", "Longitude", "RS SNR"),
    latitude="Latitude",
    longitude="Longitude",
    # "RS SNR" contains the interference: its median lies far below RSRP less thermal noise.
    sinr=sinr("RS SNR"),
    rsrp=rsrp("RSRP (LTE pcell)"),
    rsrq=rsrq("RSRQ (LTE pcell)"),
    cell="Physical cell identity (LTE pcell)",
    time="Time",
    is_note=_is_note,
    height_in_name=True,
)
