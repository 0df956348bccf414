"""The Gaussian process over many measurements: each neighbourhood of targets is conditioned on the measurements nearest to it.

The exact posterior costs the cube of the number of measured points. Covariance falls with distance, so what lies beyond
some hundred nearer measurements hardly adds to what they say of a place.
"""

from collections.abc import Callable, Iterator

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
    progress: Callable[[float], None] = lambda share: None,
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
    done = 0
    for chosen, near in _neighbourhoods(tree, targets_m / scale, np.arange(len(targets_m))):
        some = Measurements(*(getattr(measurements, name)[near] for name in ("points_m", "count", "mean_db", "squares_db2")))
        mean_db[chosen], std_db[chosen] = interpolate(kernel, some, targets_m[chosen], prior_mean_db[chosen], prior_at_db[near])
        done += len(chosen)
        progress(done / len(targets_m))
    return mean_db, std_db


def _neighbourhoods(
    tree: cKDTree, points: FloatArray, index: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The points in groups, each with the measurements nearest to its middle.

    Halved along the longest axis until a group is small and keeps to the inner half of the ball that holds those measurements:
    scattered targets would otherwise lie outside it, and be conditioned on what is far from them.
    """
    if not len(index):
        return
    middle = points[index].mean(axis=0)
    distance, near = tree.query(middle, min(NEIGHBOURS, tree.n))
    if len(index) <= TARGETS and np.linalg.norm(points[index] - middle, axis=1).max() <= distance[-1] / 2:
        yield index, np.sort(near)
        return
    axis = int(np.ptp(points[index], axis=0).argmax())
    order = index[np.argsort(points[index, axis], kind="stable")]
    for half in (order[: len(order) // 2], order[len(order) // 2 :]):
        yield from _neighbourhoods(tree, points, half)
