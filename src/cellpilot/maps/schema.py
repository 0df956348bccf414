"""The `RadioMap`: an `xarray.Dataset` over `(z, y, x)` that files, figures and worlds agree on (schema version 2; 1 is read).

| name | dims | type | content |
|---|---|---|---|
| `x`, `y`, `z` | own | float64 | cell centres [m, local, increasing]: east, north, up; x and y evenly spaced |
| `sinr_db` | z, y, x | float32 | mean SINR; NaN where unknown |
| `sinr_std_db` | z, y, x | float32 | what is not known about the mean: 0 for a simulation, standard error for measurements |
| `sinr_spread_db` | z, y, x | float32 | optional: standard deviation of the samples within a cell; NaN below two samples |
| `count` | z, y, x | int32 | samples behind the value, 0 = none |
| `filled` | z, y, x | bool | the value was estimated from other cells |
| `blocked_reason` | z, y, x | uint8 | why the drone may not enter: 0 = it may, n = entry n of the attribute `blocked_reasons` |
| `serving_sector` | z, y, x | int32 | optional: index of the strongest sector, -1 where unknown |
| `rsrp_dbm` | sector, z, y, x | float32 | optional: received power of each sector |
| `sector_name`, `sector_x_m`, `sector_y_m`, `sector_height_m`, `sector_boresight_deg` | sector | | optional: the sites |
| `sector_power_dbm`, `sector_carrier_hz`, `sector_bandwidth_hz`, `sector_load` | sector | | optional: what they send |

Attributes: see `make_map`. A leading dimension `condition` (load, hour) is reserved for a later version.
"""

import json
from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
import xarray as xr
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.attributes import plain_attributes
from cellpilot.maps.fields import BLOCKED, CELL, COORDINATES, FIELDS, canonical, check_axis
from cellpilot.maps.geodesy import Anchor
from cellpilot.maps.limits import check_size
from cellpilot.maps.reasons import (
    MARKED,
    NO_SINR,
    TABLE,
    Reason,
    blocked_cells,
    parsed_reasons,
    reasons_of_mask,
    reasons_text,
)
from cellpilot.maps.settings import LOGS
from cellpilot.provenance import versions

RadioMap: TypeAlias = xr.Dataset

SCHEMA_VERSION = 2
UNKNOWN = ("blocked", "bad")
"""What a cell without SINR means: not to be entered, or free and certainly below every threshold."""

DATUM = "WGS84; z in metres above the ground at the anchor"


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
    blocked_reason: ArrayLike | None = None,
    reasons: Sequence[Reason] = (MARKED,),
    optional: Mapping[str, ArrayLike] | None = None,
    sectors: Mapping[str, ArrayLike] | None = None,
    anchor: Anchor | None = None,
    unknown: str = LOGS.unknown,
    model: str = "",
    licence: str = "",
    seed: int | None = None,
    attributes: Mapping[str, str | int | float] | None = None,
) -> RadioMap:
    """A valid RadioMap from arrays in the order `(z, y, x)`; scalars stand for the whole map.

    `optional` holds `sinr_spread_db`, `serving_sector`, `rsrp_dbm`; `sectors` the coordinates of the dimension
    `sector` (`sector_name`, `sector_x_m`, `sector_y_m`, `sector_height_m`, `sector_boresight_deg`). `blocked_reason` (or a
    mask, for one reason) counts through `reasons` from 1; without it cells that are NaN are blocked as unknown unless
    `unknown` is "bad". `source` says what the numbers are ("simulation", "measured log"), `model` how they came about;
    `attributes` are added to the dataset's own.
    `InputError` as `validate` gives it.
    """
    values = {"sinr_db": sinr_db, "sinr_std_db": sinr_std_db, "count": count, "filled": filled, **(optional or {})}
    sinr = np.asarray(sinr_db)
    if sinr.ndim != 3:
        raise InputError(f"sinr_db has {sinr.ndim} dimension(s); expected 3 in the order z, y, x")
    if blocked_reason is None:
        blocked_reason, reasons = np.isnan(sinr) & (unknown != "bad"), (NO_SINR,)
    values["blocked_reason"] = blocked_reason
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
        TABLE: reasons_text(reasons),
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

    A map of schema version 1 becomes one of version 2. A type that holds the same values is converted (float64 to
    float32, 0/1 to bool), nothing else is repaired.
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
    if attributes["schema_version"] == 1:
        result = _upgraded(result, where)
    elif "blocked" in result.variables:
        raise InputError(
            f"{where} has the variable 'blocked' of schema version 1; expected 'blocked_reason' (0 = free): replace it"
        )
    for name, field in (COORDINATES | FIELDS).items():
        if name in result.variables:
            result[name] = canonical(result[name], name, field, where)
        elif field.required:
            raise InputError(f"{where} has no {'coordinate' if name in COORDINATES else 'variable'} {name!r} over {field.dims}")
    for name in CELL:
        check_axis(name, result[name].values, where)
    _check_values(result, where)
    return result


def _upgraded(dataset: RadioMap, where: str) -> RadioMap:
    """A map of schema version 1 as one of version 2: which cells are blocked is known, why is not."""
    for name in ("blocked", "sinr_db"):
        if name not in dataset.variables:
            raise InputError(f"{where} has no variable {name!r} over {CELL}")
    blocked, sinr_db = (canonical(dataset[n], n, f, where) for n, f in (("blocked", BLOCKED), ("sinr_db", FIELDS["sinr_db"])))
    codes, reasons = reasons_of_mask(blocked.values, np.isnan(sinr_db.values))
    return (
        dataset.drop_vars("blocked")
        .assign(blocked_reason=(CELL, codes))
        .assign_attrs({"schema_version": SCHEMA_VERSION, TABLE: reasons_text(reasons)})
    )


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
    if version not in (1, SCHEMA_VERSION):
        raise InputError(
            f"{where} has schema_version {version}; this cellpilot reads 1 and {SCHEMA_VERSION}: install the one that wrote it"
        )
    unknown = attributes.get("unknown", LOGS.unknown)
    if unknown not in UNKNOWN:
        raise InputError(f"{where} has the attribute unknown = {unknown!r}; expected one of {', '.join(UNKNOWN)}")
    for name in ("sinr_correlation_m", "sinr_common_std_db"):
        if attributes.get(name, 0.0) < 0:
            raise InputError(f"{where} has the attribute {name} = {attributes[name]:g}; expected 0 or more: correct or remove it")
    given = [f"anchor_{part}" in attributes for part in ("latitude_deg", "longitude_deg")]
    if any(given) and not all(given):
        raise InputError(f"{where} has only one of anchor_latitude_deg and anchor_longitude_deg: give both or neither")
    try:
        anchor_of(xr.Dataset(attrs=attributes))
    except (TypeError, ValueError) as error:
        raise InputError(f"{where}: {error}") from None


def _check_values(dataset: RadioMap, where: str) -> None:
    most, codes = len(parsed_reasons(dataset.attrs.get(TABLE, "[]"), where)), dataset["blocked_reason"].values
    if codes.size and codes.max() > most:
        raise InputError(
            f"{where}: blocked_reason is {codes.max()} in a cell; expected at most {most}, the number of entries in the attribute"
            f" {TABLE}: complete it"
        )
    blocked, unknown = blocked_cells(dataset), np.isnan(dataset["sinr_db"].values)
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
