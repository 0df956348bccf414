"""Fill unknown cells from measured ones, as a separate recorded step."""

from collections.abc import Callable
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from cellpilot.errors import InputError
from cellpilot.maps.estimate.gaussian_process import Kernel
from cellpilot.maps.estimate.methods import FloatArray, Known, Method, gaussian_process, inverse_distance
from cellpilot.maps.estimate.posterior import kernel_text, too_large
from cellpilot.maps.reasons import NO_SINR, TABLE, for_lack_of_data, reasons_of, reasons_text, with_reason
from cellpilot.maps.schema import UNKNOWN, RadioMap, validate
from cellpilot.maps.settings import LOGS

FillMethod = Literal["inverse-distance", "gaussian-process"]


def fill(
    dataset: RadioMap,
    radius_m: float,
    *,
    method: FillMethod = LOGS.fill,
    power: float = 2.0,
    unknown: str = LOGS.unknown,
    trend_db: ArrayLike | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> RadioMap:
    """A copy in which unknown cells near a measured cell have a value.

    Near is a measured cell of the same height within `radius_m` (horizontally, inclusive). By inverse distance, the value
    is the mean of those neighbours weighted by distance to the power of -`power`, and its `sinr_std_db` the root mean
    square error the same rule makes at measured cells, each left out once (all heights together): a lower bound across
    holes. By Gaussian process, both come from the posterior given all measured cells of all heights, around
    `trend_db [z, y, x]` if there is one (a simulation of the sites). Earlier filled cells count as unknown to both.

    Filled cells have `filled` True and `count` 0. A cell that was blocked for lack of data is free once it is filled; any
    other reason stays. What is still unknown is blocked, or with `unknown="bad"` free and without SINR. A Gaussian process
    leaves its kernel in the attributes, from which a world draws its posterior; for a map that is too large it leaves the
    reason, and its correlation length. Method and radius are written to the attributes. `InputError` for a radius below 0, a
    power that is not positive, an unknown method, or an invalid map.
    """
    if not np.isfinite(radius_m) or radius_m < 0:
        raise InputError(f"the fill radius is {radius_m:g} m; expected 0 (no filling) or more")
    if not np.isfinite(power) or power <= 0:
        raise InputError(f"the power of the distance is {power:g}; expected more than 0")
    if unknown not in UNKNOWN:
        raise InputError(f"unknown is {unknown!r}; expected one of {', '.join(UNKNOWN)}")
    methods: dict[str, Method] = {
        "inverse-distance": inverse_distance(radius_m, power),
        "gaussian-process": partial(gaussian_process, progress=progress),
    }
    if method not in methods:
        raise InputError(f"the method is {method!r}; expected one of {', '.join(methods)}")
    result = validate(dataset)
    known = measured_cells(result, trend_db)
    hole = np.isnan(result["sinr_db"].values)
    points_m = cell_centres_m(result)
    reachable = hole.ravel().copy()
    reachable[reachable] = _near(points_m[reachable], known.points_m, radius_m)
    prior_db = np.zeros(hole.size) if trend_db is None else np.asarray(trend_db, dtype=np.float64).ravel()
    sinr_db, std_db = result["sinr_db"].values.ravel().astype(np.float64), result["sinr_std_db"].values.ravel().copy()
    if reachable.any():
        estimate = methods[method](known, points_m[reachable], prior_db[reachable])
        sinr_db[reachable], std_db[reachable] = estimate.mean_db, estimate.std_db
        result.attrs = {n: value for n, value in result.attrs.items() if n not in ("fill_kernel", "fill_posterior")}
        if estimate.kernel is not None:
            result.attrs |= _posterior_attributes(estimate.kernel, hole.size, len(known.mean_db))
    filled = hole & ~np.isnan(sinr_db.reshape(hole.shape))
    still_unknown = np.isnan(sinr_db).reshape(hole.shape)
    result["sinr_db"].values = sinr_db.reshape(hole.shape).astype(np.float32)
    result["sinr_std_db"].values = std_db.reshape(hole.shape)
    result["filled"].values |= filled
    codes, reasons = result["blocked_reason"].values, reasons_of(result)
    codes = np.where(for_lack_of_data(codes, reasons) & (filled | (unknown == "bad")), 0, codes).astype(np.uint8)
    if unknown == "blocked":
        codes, reasons = with_reason(codes, reasons, still_unknown & (codes == 0), NO_SINR)
    result["blocked_reason"].values = codes
    result.attrs |= {
        TABLE: reasons_text(reasons),
        "unknown": unknown,
        "fill_method": DESCRIPTIONS[method],
        "fill_radius_m": float(radius_m),
    }
    if method == "inverse-distance":
        result.attrs["fill_power"] = float(power)
    return validate(result)


def _posterior_attributes(kernel: Kernel, n_cells: int, n_measured: int) -> dict[str, str | float]:
    reason = too_large(n_cells, n_measured)
    if reason is None:
        return {"fill_kernel": kernel_text(kernel)}
    return {"fill_posterior": reason, "sinr_correlation_m": kernel.length_m}


DESCRIPTIONS = {
    "inverse-distance": "inverse distance to measured cells of the same height",
    "gaussian-process": "Gaussian process over measured cells of all heights",
}


def measured_cells(dataset: RadioMap, trend_db: ArrayLike | None = None) -> Known:
    """The measured cells of a map."""
    sinr_db, count, measured = dataset["sinr_db"].values, dataset["count"].values, is_measured(dataset)
    spread_db = dataset["sinr_spread_db"].values[measured] if "sinr_spread_db" in dataset else np.zeros(measured.sum())
    # A map from elsewhere may not say how many samples a value has: it counts as one.
    samples = np.maximum(count[measured], 1).astype(np.float64)
    squares_db2 = np.nan_to_num((samples - 1) * spread_db.astype(np.float64) ** 2)
    prior_db = np.zeros(len(samples)) if trend_db is None else np.asarray(trend_db, dtype=np.float64)[measured]
    points_m = cell_centres_m(dataset)[measured.ravel()]
    return Known(points_m, sinr_db[measured].astype(np.float64), samples, squares_db2, prior_db)


def is_measured(dataset: RadioMap) -> NDArray[np.bool_]:
    """Which cells `[z, y, x]` have a value that no filling put there."""
    return np.asarray(~np.isnan(dataset["sinr_db"].values) & ~dataset["filled"].values)


def cell_centres_m(dataset: RadioMap) -> FloatArray:
    """Centres `[cells, 3]` of all cells: x, y, z [m], in the order of the arrays."""
    z, y, x = np.meshgrid(*(dataset[axis].values for axis in ("z", "y", "x")), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)


def _near(targets_m: FloatArray, known_m: FloatArray, radius_m: float) -> np.ndarray:
    """Whether each target has a known point of its height within the radius."""
    near = np.zeros(len(targets_m), bool)
    for z_m in np.unique(known_m[:, 2]):
        at = targets_m[:, 2] == z_m
        if at.any():
            tree = cKDTree(known_m[known_m[:, 2] == z_m, :2])
            near[at] = np.isfinite(tree.query(targets_m[at, :2], distance_upper_bound=radius_m * (1 + 1e-9) + 1e-12)[0])
    return near
