"""Fill unknown cells from measured neighbours of the same height, weighted by inverse distance."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellpilot.errors import InputError
from cellpilot.maps.schema import UNKNOWN, RadioMap, validate

FloatArray = NDArray[np.float64]


def fill(dataset: RadioMap, radius_m: float, *, power: float = 2.0, unknown: str = "blocked") -> RadioMap:
    """A copy in which unknown cells with a measured cell within `radius_m` (horizontally, inclusive) have a value.

    The value is the mean of those neighbours weighted by distance to the power of -`power`; earlier filled cells are
    no neighbours. Its `sinr_std_db` is the root mean square error the same rule makes at measured cells, each left
    out once (all heights together); without a single such pair it is the standard deviation of the measured cells.
    Cells across a hole are further from measurements than measured cells are from each other, so take it as a lower bound.

    Filled cells have `filled` True, `count` 0 and are free: restrict the airspace after filling, not before. What is
    still unknown is blocked, or with `unknown="bad"` free and without SINR. Method, power and radius are written to
    the attributes. `InputError` for a radius below 0, a power that is not positive, or an invalid map.
    """
    if not np.isfinite(radius_m) or radius_m < 0:
        raise InputError(f"the fill radius is {radius_m:g} m; expected 0 (no filling) or more")
    if not np.isfinite(power) or power <= 0:
        raise InputError(f"the power of the distance is {power:g}; expected more than 0")
    if unknown not in UNKNOWN:
        raise InputError(f"unknown is {unknown!r}; expected one of {', '.join(UNKNOWN)}")
    result = validate(dataset)
    sinr_db = result["sinr_db"].values.astype(np.float64)
    hole = np.isnan(sinr_db)
    measured = ~hole & ~result["filled"].values
    y, x = (axis.ravel() for axis in np.meshgrid(result["y"].values, result["x"].values, indexing="ij"))
    place_m = np.stack([x, y], axis=-1)
    errors_db = []
    for iz in range(sinr_db.shape[0]):
        known, holes = np.flatnonzero(measured[iz]), np.flatnonzero(hole[iz])
        values_db = sinr_db[iz].ravel()[known]
        estimate_db = _weighted(place_m[holes], place_m[known], values_db, radius_m, power)
        errors_db.append(_weighted(place_m[known], place_m[known], values_db, radius_m, power) - values_db)
        sinr_db[iz].flat[holes] = estimate_db
    filled = hole & ~np.isnan(sinr_db)
    std_db = result["sinr_std_db"].values.copy()
    std_db[filled] = _expected_error(np.concatenate(errors_db), sinr_db[measured])
    still_unknown = np.isnan(sinr_db)
    result["sinr_db"].values = sinr_db.astype(np.float32)
    result["sinr_std_db"].values = std_db
    result["filled"].values |= filled
    result["blocked"].values = np.where(still_unknown, unknown == "blocked", result["blocked"].values & ~filled)
    result.attrs |= {
        "unknown": unknown,
        "fill_method": "inverse distance to measured cells of the same height",
        "fill_radius_m": float(radius_m),
        "fill_power": float(power),
    }
    return validate(result)


def _weighted(target_m: FloatArray, known_m: FloatArray, values: FloatArray, radius_m: float, power: float) -> FloatArray:
    """Weighted mean of the known values around each target, itself excluded; NaN without a neighbour."""
    if not len(target_m) or not len(known_m):
        return np.full(len(target_m), np.nan)
    # A neighbour exactly on the circle must not be lost to the rounding of the coordinates.
    reach_m = radius_m * (1 + 1e-9)
    pairs = cKDTree(target_m).sparse_distance_matrix(cKDTree(known_m), reach_m, output_type="ndarray")
    pairs = pairs[pairs["v"] > 0]
    # The tree promises no order, and the last bit of a sum depends on it.
    pairs = pairs[np.lexsort((pairs["j"], pairs["i"]))]
    weight = (pairs["v"] / reach_m) ** -power if pairs.size else pairs["v"]
    total = np.bincount(pairs["i"], weights=weight, minlength=len(target_m))
    weighted = np.bincount(pairs["i"], weights=weight * values[pairs["j"]], minlength=len(target_m))
    with np.errstate(invalid="ignore"):
        return np.asarray(weighted / total)


def _expected_error(errors_db: FloatArray, measured_db: FloatArray) -> float:
    errors_db = errors_db[~np.isnan(errors_db)]
    if errors_db.size:
        return float(np.sqrt(np.mean(errors_db**2)))
    return float(np.std(measured_db, ddof=1)) if measured_db.size > 1 else 0.0
