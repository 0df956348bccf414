"""Ways to say what SINR is where nobody measured, all with one signature: a table that filling and the hold-out check share."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from cellpilot.array_types import FloatArray
from cellpilot.maps.estimate.gaussian_process import Kernel, Measurements, estimate_kernel
from cellpilot.maps.estimate.local import interpolate_locally


class Known(NamedTuple):
    """Measured cells."""

    points_m: FloatArray  # [cells, 3]: x, y, z
    mean_db: FloatArray  # [cells]
    n_samples: FloatArray  # [cells]
    squares_db2: FloatArray  # [cells] sum of squared deviations of the samples from their mean
    prior_db: FloatArray  # [cells] what a trend says there; 0 without one


class Estimate(NamedTuple):
    """What a method says of the targets; NaN where it says nothing."""

    mean_db: FloatArray  # [targets]
    std_db: FloatArray  # [targets] of the cell's mean, measurement noise excluded
    noise_std_db: float  # of one sample
    kernel: Kernel | None = None  # of a Gaussian process


Method = Callable[[Known, FloatArray, FloatArray], Estimate]
"""Known cells, targets `[targets, 3]` [m] and what the trend says there `[targets]` -> estimate."""


def height_mean(known: Known, targets_m: FloatArray, prior_db: FloatArray) -> Estimate:
    """The mean of all measured cells of the same height: what any method has to beat."""
    mean_db, std_db = np.full(len(targets_m), np.nan), np.full(len(targets_m), np.nan)
    for z_m in np.unique(targets_m[:, 2]):
        at = known.points_m[:, 2] == z_m
        if at.any():
            mean_db[targets_m[:, 2] == z_m] = known.mean_db[at].mean()
            std_db[targets_m[:, 2] == z_m] = known.mean_db[at].std()
    return Estimate(mean_db, std_db, 0.0)


def inverse_distance(radius_m: float, power: float = 2.0) -> Method:
    """Mean of the measured cells of the same height within a radius, weighted by distance to the power of -`power`.

    Its one uncertainty is the error the rule makes at measured cells, each left out once: their neighbours are nearer than
    those of a hole, so take it as a lower bound.
    """

    def method(known: Known, targets_m: FloatArray, prior_db: FloatArray) -> Estimate:
        mean_db = np.full(len(targets_m), np.nan)
        errors_db = []
        for z_m in np.unique(known.points_m[:, 2]):
            at, wanted = known.points_m[:, 2] == z_m, targets_m[:, 2] == z_m
            places_m, values_db = known.points_m[at, :2], known.mean_db[at]
            mean_db[wanted] = _weighted(targets_m[wanted, :2], places_m, values_db, radius_m, power)
            errors_db.append(_weighted(places_m, places_m, values_db, radius_m, power) - values_db)
        return Estimate(
            mean_db, np.where(np.isnan(mean_db), np.nan, _expected_error(np.concatenate(errors_db), known.mean_db)), 0.0
        )

    return method


def gaussian_process(
    known: Known, targets_m: FloatArray, prior_db: FloatArray, progress: Callable[[float], None] = lambda share: None
) -> Estimate:
    """Posterior of a Gaussian process over all heights, its hyper-parameters estimated from the measured cells.

    Its prior mean is the trend, with offset and factor fitted to the measured cells by least squares, or their mean without
    a trend.
    """
    measurements = Measurements(known.points_m, known.n_samples, known.mean_db, known.squares_db2)
    centred_db = known.prior_db - known.prior_db.mean()
    square = float(centred_db @ centred_db)
    factor = max(float(centred_db @ known.mean_db) / square, 0.0) if square > 0 else 0.0
    fitted = lambda trend_db: known.mean_db.mean() + factor * (trend_db - known.prior_db.mean())
    kernel = estimate_kernel(measurements, fitted(known.prior_db), Kernel(form="exponential"))
    mean_db, std_db = interpolate_locally(kernel, measurements, targets_m, fitted(prior_db), fitted(known.prior_db), progress)
    return Estimate(mean_db, std_db, kernel.noise_std_db, kernel)


def without_trend(method: Method) -> Method:
    """The same method, deaf to a trend."""

    def deaf(known: Known, targets_m: FloatArray, prior_db: FloatArray) -> Estimate:
        return method(known._replace(prior_db=np.zeros_like(known.prior_db)), targets_m, np.zeros_like(prior_db))

    return deaf


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
    # Distances in radii keep large powers within what a number can hold.
    unit_m = reach_m if np.isfinite(reach_m) and reach_m > 0 else 1.0
    weight = (pairs["v"] / unit_m) ** -power
    total = np.bincount(pairs["i"], weights=weight, minlength=len(target_m))
    weighted = np.bincount(pairs["i"], weights=weight * values[pairs["j"]], minlength=len(target_m))
    with np.errstate(invalid="ignore"):
        return np.asarray(weighted / total)


def _expected_error(errors_db: FloatArray, measured_db: FloatArray) -> float:
    errors_db = errors_db[~np.isnan(errors_db)]
    if errors_db.size:
        return float(np.sqrt(np.mean(errors_db**2)))
    return float(np.std(measured_db, ddof=1)) if measured_db.size > 1 else 0.0
