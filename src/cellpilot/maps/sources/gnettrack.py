"""Log of G-NetTrack Pro, as in the public 5G data set of University College Cork: no altitude, `-` for a missing value."""

from cellpilot.maps.sources.log_format import LogFormat, rsrp, rsrq, sinr

GNETTRACK = LogFormat(
    name="G-NetTrack Pro",
    signature=("Timestamp", "Longitude", "Latitude", "NetworkMode", "SNR"),
    latitude="Latitude",
    longitude="Longitude",
    sinr=sinr("SNR"),
    rsrp=rsrp("RSRP"),
    rsrq=rsrq("RSRQ"),
    cell="CellID",
    time="Timestamp",
)
