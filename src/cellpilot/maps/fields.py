"""The variables and coordinates of a `RadioMap`: dimensions, type and unit of each, and how an array comes to them."""

from typing import NamedTuple

import numpy as np
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.limits import check_values

CELL = ("z", "y", "x")
ALSO_WRITTEN = {
    "m": ("metre", "metres", "meter", "meters"),
    "degree": ("deg", "degrees", "°"),
    "1": ("", "-", "dimensionless"),
    "dB": ("db", "decibel"),
    "dBm": ("dbm",),
    "Hz": ("hz", "hertz"),
}
"""Other ways to write the units of the schema."""


class CellField(NamedTuple):
    """One variable or coordinate of the schema."""

    dims: tuple[str, ...]
    dtype: type[np.generic]
    units: str
    long_name: str
    required: bool = False


FIELDS = {
    "sinr_db": CellField(CELL, np.float32, "dB", "mean SINR", required=True),
    "sinr_std_db": CellField(CELL, np.float32, "dB", "standard uncertainty of the mean SINR", required=True),
    "sinr_spread_db": CellField(CELL, np.float32, "dB", "standard deviation of SINR within the cell"),
    "count": CellField(CELL, np.int32, "1", "number of samples", required=True),
    "filled": CellField(CELL, np.bool_, "1", "value estimated from other cells", required=True),
    "blocked_reason": CellField(CELL, np.uint8, "1", "why the cell may not be entered, 0 = it may", required=True),
    "serving_sector": CellField(CELL, np.int32, "1", "index of the serving sector, -1 where unknown"),
    "rsrp_dbm": CellField(("sector", *CELL), np.float32, "dBm", "reference signal received power"),
}
BLOCKED = CellField(CELL, np.bool_, "1", "cell that may not be entered", required=True)
"""The variable `blocked` of schema version 1, in the place of `blocked_reason`."""
COORDINATES = {
    "z": CellField(("z",), np.float64, "m", "height above the anchor", required=True),
    "y": CellField(("y",), np.float64, "m", "north of the anchor", required=True),
    "x": CellField(("x",), np.float64, "m", "east of the anchor", required=True),
    "sector": CellField(("sector",), np.int32, "1", "index of the sector"),
    "sector_name": CellField(("sector",), np.str_, "1", "name of the sector"),
    "sector_x_m": CellField(("sector",), np.float64, "m", "site of the sector, east of the anchor"),
    "sector_y_m": CellField(("sector",), np.float64, "m", "site of the sector, north of the anchor"),
    "sector_height_m": CellField(("sector",), np.float64, "m", "antenna height of the sector"),
    "sector_boresight_deg": CellField(("sector",), np.float64, "degree", "boresight of the sector, counter-clockwise from east"),
    "sector_power_dbm": CellField(("sector",), np.float64, "dBm", "transmit power of the sector"),
    "sector_carrier_hz": CellField(("sector",), np.float64, "Hz", "carrier frequency of the sector"),
    "sector_bandwidth_hz": CellField(("sector",), np.float64, "Hz", "channel bandwidth of the sector"),
    "sector_load": CellField(("sector",), np.float64, "1", "share of the carrier in use in the sector"),
}


def canonical(array: xr.DataArray, name: str, field: CellField, where: str) -> xr.DataArray:
    """An array with the type, unit and long name of its field; `InputError` if its dimensions, unit or values are others."""
    if array.dims != field.dims:
        raise InputError(f"{where}: {name} has the dimensions {array.dims}; expected {field.dims}: transpose or squeeze it")
    values = array.values
    if field.dtype is np.str_:
        values = values.astype(str)
    elif values.dtype.kind not in "fiub":
        raise InputError(f"{where}: {name} is of type {values.dtype}; expected numbers [{field.units}]")
    else:
        values = _cast(values, name, field, where)
    _check_units(array, name, field, where)
    check_values(name, values, where)
    attrs = array.attrs | {"units": field.units, "long_name": field.long_name}
    return xr.DataArray(values, dims=field.dims, attrs=attrs)


def _check_units(array: xr.DataArray, name: str, field: CellField, where: str) -> None:
    """`InputError` if a unit is stated and is another one."""
    stated = array.attrs.get("units")
    if stated is None:
        return
    if not isinstance(stated, str) or stated.strip() not in (field.units, *ALSO_WRITTEN.get(field.units, ())):
        raise InputError(
            f"{where}: {name} has the units {stated!r}; expected {field.units!r}: convert the values, or remove the attribute"
            " if they are right"
        )


def _cast(values: np.ndarray, name: str, field: CellField, where: str) -> np.ndarray:
    if np.isinf(values).any():
        raise InputError(f"{where}: {name} has {np.isinf(values).sum()} infinite value(s); unknown is NaN: replace them")
    if np.issubdtype(field.dtype, np.floating):
        with np.errstate(over="ignore"):
            cast = values.astype(field.dtype)
        same = np.isinf(cast).sum() == 0
    else:
        with np.errstate(invalid="ignore"):
            cast = values.astype(field.dtype)
        same = np.array_equal(cast, values)
    if not same:
        expected = "true or false (0 or 1)" if field.dtype is np.bool_ else f"values that fit {np.dtype(field.dtype).name}"
        raise InputError(f"{where}: {name} holds values that are not {np.dtype(field.dtype).name}; expected {expected}")
    return cast


def check_axis(name: str, centres_m: np.ndarray, where: str) -> None:
    """`InputError` unless cell centres increase, evenly in x and y."""
    if not centres_m.size or not np.isfinite(centres_m).all():
        raise InputError(f"{where}: coordinate {name} is empty or not finite; expected cell centres [m]")
    step_m = np.diff(centres_m)
    if (step_m <= 0).any():
        raise InputError(f"{where}: coordinate {name} does not increase; expected increasing metres: sort the map by {name}")
    # Heights are whatever was flown; x and y make up the squares that a step of the drone crosses.
    if name != "z" and step_m.size and np.ptp(step_m) > 1e-6 * step_m.max():
        raise InputError(
            f"{where}: coordinate {name} is uneven (steps {step_m.min():g} to {step_m.max():g} m);"
            " expected equal steps: resample the map"
        )
