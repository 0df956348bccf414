"""Antenna files of the Planet format (.msi, .pln): a header, and 360 attenuations each of a horizontal and a vertical cut.

Horizontal angles run clockwise from boresight, vertical ones downwards from the horizon; attenuations are positive dB below
the peak. GAIN is in dBd unless the file says dBi.
"""

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellpilot.errors import InputError
from cellpilot.radio.antenna_pattern import PatternAntenna
from cellpilot.radio.ranges import FloatArray
from cellpilot.radio.settings import COLUMN
from cellpilot.storage import write_atomically

DBD_DBI = 2.15
"""Gain of a half-wave dipole [dBi]."""

CUTS = ("HORIZONTAL", "VERTICAL")
MOST_TILT_DEG, MOST_GAIN_DB, MOST_ATTENUATION_DB = 90.0, 100.0, 1000.0


@dataclass(frozen=True, eq=False)
class AntennaFile:
    """What an antenna file says."""

    header: dict[str, str]
    """All its lines but the cuts, by their first word in capitals; texts of a word that comes again are joined by "\\n".

    Of a word that can have one meaning only (NAME, GAIN, FREQUENCY, TILT) the first text counts.
    """
    gain_dbi: float
    frequency_hz: float | None
    electrical_tilt_deg: float
    """As stated (ELECTRICAL_TILT, or a number after TILT), else the downtilt at which the vertical cut has its peak."""
    horizontal_db: FloatArray
    vertical_db: FloatArray

    def antenna(
        self, electrical_tilt_deg: float | None = None, mechanical_tilt_deg: float = COLUMN.mechanical_tilt_deg
    ) -> PatternAntenna:
        """The antenna as measured, or with its vertical cut shifted from the file's electrical tilt to another one."""
        shift_deg = 0.0 if electrical_tilt_deg is None else electrical_tilt_deg - self.electrical_tilt_deg
        name = _first(self.header, "NAME")
        return PatternAntenna(self.gain_dbi, self.horizontal_db, self.vertical_db, shift_deg, mechanical_tilt_deg, name)


def read_antenna(path: str | Path) -> AntennaFile:
    """The antenna in a .msi or .pln file.

    `InputError` with file and line for a missing GAIN, a unit that is neither dBd nor dBi, a cut that is missing or has other
    than 360 lines, angles that are not the whole degrees 0 to 359 in order, or attenuations that are negative or no numbers.
    """
    path = Path(path)
    try:
        lines = path.read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except (OSError, ValueError) as error:
        raise InputError(
            f"{path}: cannot be read ({getattr(error, 'strerror', None) or error}); expected an antenna file (.msi or .pln)"
        ) from None
    texts: dict[str, list[str]] = {}
    cuts: dict[str, FloatArray] = {}
    number = 0
    while number < len(lines):
        word, _, rest = lines[number].strip().replace("\t", " ").partition(" ")
        number += 1
        if word.upper() in cuts:
            raise InputError(f"{path}, line {number}: a second cut {word.upper()}; expected one: remove the other")
        if word.upper() in CUTS:
            cuts[word.upper()] = _read_cut(path, lines, number, word.upper())
            number += 360
        elif word:
            _refuse_stray(path, number, word, cuts)
            texts.setdefault(word.upper(), []).append(rest.strip())
    for cut in CUTS:
        if cut not in cuts:
            raise InputError(f"{path}: no line {cut} 360; expected a horizontal and a vertical cut of 360 lines each")
    horizontal_db, vertical_db = (cuts[cut] for cut in CUTS)
    bare = PatternAntenna(0.0, horizontal_db, vertical_db)
    header = {word: "\n".join(found) for word, found in texts.items()}
    tilt_deg = _stated_tilt(path, header)
    return AntennaFile(
        header,
        _gain_dbi(path, header),
        _frequency_hz(path, header),
        bare.downtilt_deg if tilt_deg is None else tilt_deg,
        horizontal_db,
        vertical_db,
    )


def write_antenna(antenna: AntennaFile, path: str | Path) -> None:
    """Write the antenna as a Planet file that `read_antenna` reads back equal."""
    write_atomically(Path(path), antenna_text(antenna))


def antenna_text(antenna: AntennaFile) -> str:
    """The text of the Planet file that `write_antenna` writes."""
    header = {"NAME": "antenna"} | antenna.header | {"GAIN": f"{float(antenna.gain_dbi)!r} dBi"}
    text = [f"{word} {line}".rstrip() for word, lines in header.items() for line in lines.split("\n")]
    for name, cut_db in zip(CUTS, (antenna.horizontal_db, antenna.vertical_db), strict=True):
        text += [f"{name} 360", *(f"{degree} {value!r}" for degree, value in enumerate(cut_db.tolist()))]
    return "\n".join(text) + "\n"


def _first(header: dict[str, str], word: str) -> str:
    """The first text of that word; empty where there is none."""
    return header.get(word, "").partition("\n")[0]


def _read_cut(path: Path, lines: list[str], start: int, name: str) -> FloatArray:
    """The 360 attenuations below the line `start` (counted from 1)."""
    cut_db = np.empty(360)
    for degree in range(360):
        number = start + degree
        fields = lines[number].split() if number < len(lines) else []
        try:
            angle_deg, cut_db[degree] = map(float, fields)
        except ValueError:
            found = repr(lines[number].strip()) if number < len(lines) else "the end of the file"
            raise InputError(
                f"{path}, line {number + 1}: {found} as line {degree + 1} of the cut {name}; expected 360 lines of angle and"
                f" attenuation [dB], the next being {degree}"
            ) from None
        if angle_deg != degree:
            raise InputError(f"{path}, line {number + 1}: angle {fields[0]} in the cut {name}; expected {degree}")
        if not 0 <= cut_db[degree] <= MOST_ATTENUATION_DB:
            raise InputError(
                f"{path}, line {number + 1}: attenuation {fields[1]} dB in the cut {name};"
                f" expected 0 to {MOST_ATTENUATION_DB:g} dB below the peak"
            )
    return cut_db


def _refuse_stray(path: Path, number: int, word: str, cuts: dict[str, FloatArray]) -> None:
    if cuts and re.fullmatch(r"[-+.\d]+", word):
        raise InputError(f"{path}, line {number}: more than 360 lines in the cut {list(cuts)[-1]}; expected exactly 360")


def _gain_dbi(path: Path, header: dict[str, str]) -> float:
    text = _first(header, "GAIN")
    found = re.fullmatch(r"([-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?)\s*(dbd|dbi)?", text, re.IGNORECASE)
    if found is None:
        raise InputError(f"{path}: GAIN is {text!r}; expected a number in dBd, or with the unit dBd or dBi")
    if abs(float(found[1])) > MOST_GAIN_DB:
        raise InputError(f"{path}: GAIN is {text!r}; expected at most {MOST_GAIN_DB:g} dB, as antennas have it")
    return float(found[1]) + (0.0 if (found[2] or "dBd").lower() == "dbi" else DBD_DBI)


def _frequency_hz(path: Path, header: dict[str, str]) -> float | None:
    text = _first(header, "FREQUENCY")
    if not text:
        return None
    found = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(MHz|GHz)?", text, re.IGNORECASE)
    if found is None or not 0 < (frequency_hz := float(found[1]) * (1e9 if (found[2] or "").lower() == "ghz" else 1e6)) < 1e12:
        raise InputError(f"{path}: FREQUENCY is {text!r}; expected one number in MHz, or with the unit MHz or GHz")
    return frequency_hz


def _stated_tilt(path: Path, header: dict[str, str]) -> float | None:
    """The number after ELECTRICAL_TILT or TILT, where one of them has a number."""
    for key in ("ELECTRICAL_TILT", "TILT"):
        text = _first(header, key)
        if not re.search(r"\d", text):
            continue
        found = re.fullmatch(r"(?:[A-Za-z]+\s+)?([-+]?\d+(?:\.\d+)?)\s*(?:deg|degrees|°)?", text)
        if found is None or abs(float(found[1])) > MOST_TILT_DEG:
            raise InputError(f"{path}: {key} is {text!r}; expected one number from -90 to 90 [deg]")
        return float(found[1])
    return None
