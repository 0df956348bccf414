"""The Gaussian process over many measurements: each neighbourhood of targets is conditioned on the measurements nearest to it.

The exact posterior costs the cube of the number of measured points. Covariance falls with distance, so what lies beyond
some hundred nearer measurements hardly adds to what they say of a place.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from cellpilot.maps.estimate.gaussian_process import FloatArray, Kernel, Measurements, interpolate

EXACT_POINTS = 1_500
"""Up to so many measured points the posterior is exact."""
NEIGHBOURS = 500
"""Measured points a neighbourhood is conditioned on beyond that."""
TARGETS = 200
"""Targets of one neighbourhood, at most."""


def interpolate_locally(
    kernel: Kernel,
    measurements: Measurements,
    targets_m: FloatArray,
    prior_mean_db: ArrayLike = 0.0,
    prior_at_db: ArrayLike = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """`interpolate` with neighbourhoods: mean and standard deviation [dB] `[targets]`. Exact for up to 1,500 measured points."""
    n = len(measurements.mean_db)
    prior_mean_db = np.broadcast_to(np.asarray(prior_mean_db, dtype=np.float64), len(targets_m))
    prior_at_db = np.broadcast_to(np.asarray(prior_at_db, dtype=np.float64), n)
    if n <= EXACT_POINTS:
        return interpolate(kernel, measurements, targets_m, prior_mean_db, prior_at_db)
    scale = np.array([kernel.length_m, kernel.length_m, kernel.vertical_length_m])
    tree = cKDTree(measurements.points_m / scale)
    mean_db, std_db = np.empty(len(targets_m)), np.empty(len(targets_m))
    for chosen in _neighbourhoods(targets_m / scale, np.arange(len(targets_m))):
        middle = (targets_m[chosen] / scale).mean(axis=0)
        near = np.sort(tree.query(middle, NEIGHBOURS)[1])
        some = Measurements(*(getattr(measurements, name)[near] for name in ("points_m", "count", "mean_db", "squares_db2")))
        mean_db[chosen], std_db[chosen] = interpolate(kernel, some, targets_m[chosen], prior_mean_db[chosen], prior_at_db[near])
    return mean_db, std_db


def _neighbourhoods(points: FloatArray, index: NDArray[np.int64]) -> Iterator[NDArray[np.int64]]:
    """The points in groups of neighbours: halved along the longest axis until a group is small."""
    if len(index) <= TARGETS:
        if len(index):
            yield index
        return
    axis = int(np.ptp(points[index], axis=0).argmax())
    order = index[np.argsort(points[index, axis], kind="stable")]
    for half in (order[: len(order) // 2], order[len(order) // 2 :]):
        yield from _neighbourhoods(points, half)
