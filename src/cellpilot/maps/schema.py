"""The `RadioMap`: an `xarray.Dataset` over `(z, y, x)` that files, figures and worlds agree on (schema version 1).

| name | dims | type | content |
|---|---|---|---|
| `x`, `y`, `z` | own | float64 | cell centres [m, local, increasing]: east, north, up; x and y evenly spaced |
| `sinr_db` | z, y, x | float32 | mean SINR; NaN where unknown |
| `sinr_std_db` | z, y, x | float32 | what is not known about the mean: 0 for a simulation, standard error for measurements |
| `sinr_spread_db` | z, y, x | float32 | optional: standard deviation of the samples within a cell; NaN below two samples |
| `count` | z, y, x | int32 | samples behind the value, 0 = none |
| `filled` | z, y, x | bool | the value was estimated from other cells |
| `blocked` | z, y, x | bool | the drone may not enter |
| `serving_sector` | z, y, x | int32 | optional: index of the strongest sector, -1 where unknown |
| `rsrp_dbm` | sector, z, y, x | float32 | optional: received power of each sector |
| `sector_name`, `sector_x_m`, `sector_y_m`, `sector_height_m`, `sector_boresight_deg` | sector | | optional: the sites |
| `sector_power_dbm`, `sector_carrier_hz`, `sector_bandwidth_hz`, `sector_load` | sector | | optional: what they send |

Attributes: see `make_map`. A leading dimension `condition` (load, hour) is reserved for a later version.
"""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.attributes import plain_attributes
from cellpilot.maps.geodesy import Anchor
from cellpilot.maps.limits import check_range, check_size
from cellpilot.provenance import versions

RadioMap: TypeAlias = xr.Dataset

SCHEMA_VERSION = 1
UNKNOWN = ("blocked", "bad")
"""What a cell without SINR means: not to be entered, or free and certainly below every threshold."""

DATUM = "WGS84; z in metres above the ground at the anchor"
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


class Field(NamedTuple):
    """One variable or coordinate of the schema."""

    dims: tuple[str, ...]
    dtype: type[np.generic]
    units: str
    long_name: str
    required: bool = False


FIELDS = {
    "sinr_db": Field(CELL, np.float32, "dB", "mean SINR", required=True),
    "sinr_std_db": Field(CELL, np.float32, "dB", "standard uncertainty of the mean SINR", required=True),
    "sinr_spread_db": Field(CELL, np.float32, "dB", "standard deviation of SINR within the cell"),
    "count": Field(CELL, np.int32, "1", "number of samples", required=True),
    "filled": Field(CELL, np.bool_, "1", "value estimated from other cells", required=True),
    "blocked": Field(CELL, np.bool_, "1", "cell that may not be entered", required=True),
    "serving_sector": Field(CELL, np.int32, "1", "index of the serving sector, -1 where unknown"),
    "rsrp_dbm": Field(("sector", *CELL), np.float32, "dBm", "reference signal received power"),
}
COORDINATES = {
    "z": Field(("z",), np.float64, "m", "height above the anchor", required=True),
    "y": Field(("y",), np.float64, "m", "north of the anchor", required=True),
    "x": Field(("x",), np.float64, "m", "east of the anchor", required=True),
    "sector": Field(("sector",), np.int32, "1", "index of the sector"),
    "sector_name": Field(("sector",), np.str_, "1", "name of the sector"),
    "sector_x_m": Field(("sector",), np.float64, "m", "site of the sector, east of the anchor"),
    "sector_y_m": Field(("sector",), np.float64, "m", "site of the sector, north of the anchor"),
    "sector_height_m": Field(("sector",), np.float64, "m", "antenna height of the sector"),
    "sector_boresight_deg": Field(("sector",), np.float64, "degree", "boresight of the sector, counter-clockwise from east"),
    "sector_power_dbm": Field(("sector",), np.float64, "dBm", "transmit power of the sector"),
    "sector_carrier_hz": Field(("sector",), np.float64, "Hz", "carrier frequency of the sector"),
    "sector_bandwidth_hz": Field(("sector",), np.float64, "Hz", "channel bandwidth of the sector"),
    "sector_load": Field(("sector",), np.float64, "1", "share of the carrier in use in the sector"),
}


def make_map(
    sinr_db: ArrayLike,
    *,
    x_m: ArrayLike,
    y_m: ArrayLike,
    z_m: ArrayLike,
    source: str,
    sinr_std_db: ArrayLike = 0.0,
    count: ArrayLike = 0,
    filled: ArrayLike = False,
    blocked: ArrayLike | None = None,
    optional: Mapping[str, ArrayLike] | None = None,
    sectors: Mapping[str, ArrayLike] | None = None,
    anchor: Anchor | None = None,
    unknown: str = "blocked",
    model: str = "",
    licence: str = "",
    seed: int | None = None,
    attributes: Mapping[str, str | int | float] | None = None,
) -> RadioMap:
    """A valid RadioMap from arrays in the order `(z, y, x)`; scalars stand for the whole map.

    `optional` holds `sinr_spread_db`, `serving_sector`, `rsrp_dbm`; `sectors` the coordinates of the dimension
    `sector` (`sector_name`, `sector_x_m`, `sector_y_m`, `sector_height_m`, `sector_boresight_deg`). Cells that are NaN
    are blocked unless `blocked` says otherwise or `unknown` is "bad". `source` says what the numbers are
    ("simulation", "measured log"), `model` how they came about; `attributes` are added to the dataset's own.
    `InputError` as `validate` gives it.
    """
    values = {"sinr_db": sinr_db, "sinr_std_db": sinr_std_db, "count": count, "filled": filled, **(optional or {})}
    sinr = np.asarray(sinr_db)
    if sinr.ndim != 3:
        raise InputError(f"sinr_db has {sinr.ndim} dimension(s); expected 3 in the order z, y, x")
    values["blocked"] = (np.isnan(sinr) & (unknown != "bad")) if blocked is None else blocked
    coords = {"z": np.atleast_1d(z_m), "y": np.atleast_1d(y_m), "x": np.atleast_1d(x_m)}
    if sectors:
        names = {name: np.asarray(value) for name, value in sectors.items()}
        coords |= {"sector": np.arange(len(next(iter(names.values())))), **names}
    arrays = {name: np.asarray(value) for name, value in values.items()}
    arrays = {name: np.broadcast_to(value, sinr.shape) if value.ndim == 0 else value for name, value in arrays.items()}
    _check_known([*arrays, *coords])
    try:
        dataset = xr.Dataset(
            {name: (FIELDS[name].dims, value) for name, value in arrays.items()},
            {name: (COORDINATES[name].dims, value) for name, value in coords.items()},
        )
    except ValueError as error:
        raise InputError(f"the arrays of the map do not fit together: {' '.join(str(error).split())}") from None
    dataset.attrs = {
        "schema_version": SCHEMA_VERSION,
        **_anchor_attributes(anchor),
        "source": source,
        "model": model,
        "unknown": unknown,
        "licence": licence,
        "provenance": json.dumps(versions(), sort_keys=True),
        **({} if seed is None else {"seed": seed}),
        **(attributes or {}),
    }
    return validate(dataset)


def anchor_of(dataset: RadioMap) -> Anchor | None:
    """The anchor of the map, or None for a map that lies nowhere on Earth."""
    if "anchor_latitude_deg" not in dataset.attrs:
        return None
    return Anchor(*(float(dataset.attrs.get(f"anchor_{part}", 0.0)) for part in ("latitude_deg", "longitude_deg", "altitude_m")))


def grid_of(dataset: RadioMap) -> Grid:
    """The grid of a valid map, cell centres [m]."""
    x_m, y_m, z_m = (tuple(float(value) for value in dataset[name].values) for name in "xyz")
    return Grid(x_m, y_m, z_m)


def validate(dataset: RadioMap, where: str = "the map") -> RadioMap:
    """The same map with the schema's types, units and long names.

    A type that holds the same values is converted (float64 to float32, 0/1 to bool), nothing else is repaired.
    `InputError` names `where` and the variable, dimension or attribute at fault: missing or misplaced variables,
    uneven or falling coordinates, NaN in a free cell (allowed if the attribute `unknown` is "bad"), infinities, a
    negative uncertainty, a map of one cell or without a free one, sectors out of range.
    """
    attributes = plain_attributes(dataset.attrs, where)
    _check_attributes(attributes, where)
    check_header(dataset, where)
    if "condition" in dataset.dims:
        raise InputError(f"{where} has the reserved dimension 'condition': select one, e.g. dataset.isel(condition=0, drop=True)")
    # Other tools may have written the sites as variables.
    result = dataset.set_coords([name for name in COORDINATES if name in dataset.variables]).assign_attrs(attributes)
    for name, field in (COORDINATES | FIELDS).items():
        if name in result.variables:
            result[name] = _canonical(result[name], name, field, where)
        elif field.required:
            raise InputError(f"{where} has no {'coordinate' if name in COORDINATES else 'variable'} {name!r} over {field.dims}")
    for name in CELL:
        _check_axis(name, result[name].values, where)
    _check_values(result, where)
    return result


def check_header(dataset: RadioMap, where: str) -> None:
    """`InputError` if the sizes of a map, whose values need not be in memory, are beyond what is read."""
    check_size(tuple(dataset.sizes.get(axis, 1) for axis in CELL), where)


def _check_known(names: list[str]) -> None:
    for name in names:
        if name not in FIELDS and name not in COORDINATES:
            raise InputError(f"{name!r} is no variable of a RadioMap; expected one of {', '.join([*FIELDS, *COORDINATES])}")


def _anchor_attributes(anchor: Anchor | None) -> dict[str, str | float]:
    if anchor is None:
        return {}
    return {
        "anchor_latitude_deg": anchor.latitude_deg,
        "anchor_longitude_deg": anchor.longitude_deg,
        "anchor_altitude_m": anchor.altitude_m,
        "datum": DATUM,
    }


def _check_attributes(attributes: Mapping[str, Any], where: str) -> None:
    version = attributes.get("schema_version")
    if version is None:
        raise InputError(f"{where} has no attribute 'schema_version': not a RadioMap; build one with cellpilot.maps.make_map")
    if version != SCHEMA_VERSION:
        raise InputError(
            f"{where} has schema_version {version}; this cellpilot reads {SCHEMA_VERSION}: install the one that wrote it"
        )
    unknown = attributes.get("unknown", "blocked")
    if unknown not in UNKNOWN:
        raise InputError(f"{where} has the attribute unknown = {unknown!r}; expected one of {', '.join(UNKNOWN)}")
    given = [f"anchor_{part}" in attributes for part in ("latitude_deg", "longitude_deg")]
    if any(given) and not all(given):
        raise InputError(f"{where} has only one of anchor_latitude_deg and anchor_longitude_deg: give both or neither")
    try:
        anchor_of(xr.Dataset(attrs=attributes))
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def _canonical(array: xr.DataArray, name: str, field: Field, where: str) -> xr.DataArray:
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
    check_range(name, values, where)
    attrs = array.attrs | {"units": field.units, "long_name": field.long_name}
    return xr.DataArray(values, dims=field.dims, attrs=attrs)


def _check_units(array: xr.DataArray, name: str, field: Field, where: str) -> None:
    """`InputError` if a unit is stated and is another one."""
    stated = array.attrs.get("units")
    if stated is None:
        return
    if not isinstance(stated, str) or stated.strip() not in (field.units, *ALSO_WRITTEN.get(field.units, ())):
        raise InputError(
            f"{where}: {name} has the units {stated!r}; expected {field.units!r}: convert the values, or remove the attribute"
            " if they are right"
        )


def _cast(values: np.ndarray, name: str, field: Field, where: str) -> np.ndarray:
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


def _check_axis(name: str, centres_m: np.ndarray, where: str) -> None:
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


def _check_values(dataset: RadioMap, where: str) -> None:
    blocked, unknown = dataset["blocked"].values, np.isnan(dataset["sinr_db"].values)
    if blocked.size < 2:
        raise InputError(f"{where} has {blocked.size} cell; a flight needs at least 2: use a larger area or smaller bins")
    if blocked.all():
        raise InputError(f"{where}: every cell is blocked; expected free ones: give samples, fill more of it, or unknown='bad'")
    if (unknown & ~blocked).any() and dataset.attrs.get("unknown") != "bad":
        first = tuple(np.argwhere(unknown & ~blocked)[0].tolist())
        raise InputError(
            f"{where}: sinr_db is NaN in {(unknown & ~blocked).sum()} free cell(s), the first at (z, y, x) = {first};"
            " block them, fill them, or set the attribute unknown = 'bad'"
        )
    std_db = dataset["sinr_std_db"].values
    if (std_db < 0).any() or np.isnan(std_db[~unknown]).any():
        raise InputError(f"{where}: sinr_std_db is negative or NaN in a cell with SINR; expected 0 dB or more")
    if (dataset["count"].values < 0).any():
        raise InputError(f"{where}: count is negative; expected the number of samples, 0 for none")
    if "sinr_spread_db" in dataset and (dataset["sinr_spread_db"].values < 0).any():
        raise InputError(f"{where}: sinr_spread_db is negative; expected 0 dB or more, NaN where unknown")
    if "serving_sector" in dataset:
        serving = dataset["serving_sector"].values
        if serving.min() < -1 or serving.max() >= dataset.sizes.get("sector", np.inf):
            raise InputError(
                f"{where}: serving_sector holds {serving.min()} to {serving.max()}; expected -1 or the index of a sector"
            )
