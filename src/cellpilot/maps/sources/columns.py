"""Any log with a header: the person who imports it says which column is what (`--columns lat=..,lon=..,alt=..,sinr=..`)."""

import re

from cellpilot.errors import InputError
from cellpilot.maps.sources.log_format import LogFormat, rsrp, rsrq, sinr
from cellpilot.maps.text_table import Column

COLUMN_NAMES = ("lat", "lon", "sinr", "alt", "rsrp", "rsrq", "cell", "time", "accuracy")
REQUIRED_ROLES = ("lat", "lon", "sinr")
METRES_PER_UNIT = {"m": 1.0, "ft": 0.3048}
"""The international foot."""

UNIT_IN_NAME = re.compile(r"(?:^|[^a-z])(m|meters?|metres?|ft|feet|foot)(?:$|[^a-z])", re.IGNORECASE)


def named_columns(
    text: str, altitude_unit: str | None = None, altitude_reference: str | None = None, *, height_stated: bool = False
) -> LogFormat:
    """The format that `lat=COLUMN,lon=COLUMN,sinr=COLUMN,...` describes.

    The unit of the altitude is `altitude_unit` (m or ft), else what the column's name says (`alt_m`, `Height [ft]`). What
    it counts from is `altitude_reference`. With `height_stated` somebody says one height for all, and the column of the
    altitude is left alone. `InputError` for an unknown or repeated name, a missing one of lat, lon and
    sinr, for an altitude whose unit or reference nobody states, a unit that contradicts the name, and for unit and reference
    of no altitude.
    """
    chosen: dict[str, str] = {}
    for part in text.split(","):
        name, equals, column = (piece.strip() for piece in part.partition("="))
        if not equals or not column or name not in COLUMN_NAMES or name in chosen:
            raise InputError(
                f"`columns` has {part.strip()!r}; expected NAME=COLUMN with each of {', '.join(COLUMN_NAMES)} at most once"
            )
        chosen[name] = column
    for name in REQUIRED_ROLES:
        if name not in chosen:
            raise InputError(f"`columns` names no column for {name}; expected at least {', '.join(REQUIRED_ROLES)}")
    factor, altitude = 1.0, None
    if "alt" not in chosen or height_stated:
        for flag, given in (("`altitude_unit`", altitude_unit), ("`altitude_reference`", altitude_reference)):
            if given is not None:
                raise InputError(f"{flag} {given} is for an altitude column, which is not read: leave it out, or name it alt=..")
    else:
        factor = METRES_PER_UNIT[_unit(chosen["alt"], altitude_unit)]
        altitude = Column(chosen["alt"], -500.0 / factor, 10_000.0 / factor, "m" if factor == 1.0 else "ft")
        if altitude_reference is None:
            raise InputError(
                f"nothing says what the altitude in {chosen['alt']!r} counts from;"
                " give `altitude_reference` take-off, ellipsoid or sea-level"
            )
    return LogFormat(
        name="named columns",
        signature=(),
        latitude=chosen["lat"],
        longitude=chosen["lon"],
        sinr=sinr(chosen["sinr"]),
        rsrp=rsrp(chosen["rsrp"]) if "rsrp" in chosen else None,
        rsrq=rsrq(chosen["rsrq"]) if "rsrq" in chosen else None,
        cell=chosen.get("cell"),
        time=chosen.get("time"),
        altitude=altitude,
        altitude_reference=(altitude_reference or "take-off").replace("-level", " level"),
        metres_per_unit=factor,
        accuracy=chosen.get("accuracy"),
    )


def _unit(column: str, given: str | None) -> str:
    found = UNIT_IN_NAME.search(column)
    named = None if found is None else "m" if found[1].lower().startswith("m") else "ft"
    if given is not None and named not in (None, given):
        raise InputError(f"`altitude_unit` is {given}, but the column {column!r} is in {named}: leave out the one that is wrong")
    if given is None and named is None:
        raise InputError(
            f"nothing says whether the altitude in {column!r} is in metres or feet: give `altitude_unit` m or `altitude_unit` ft"
        )
    return given or str(named)
