"""From scattered samples to bins. The order of the samples changes nothing, not even the last bit."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.limits import MAX_CELLS


@dataclass(frozen=True)
class Bins:
    """Samples gathered on a regular grid over the rectangle that holds them all."""

    x_m: FloatArray  # [nx] bin centres
    y_m: FloatArray  # [ny]
    z_m: FloatArray  # [nz] the heights of the samples
    mean: FloatArray  # [nz, ny, nx], NaN in an empty bin
    std: FloatArray  # [nz, ny, nx] with n - 1, NaN below two samples
    count: NDArray[np.int32]  # [nz, ny, nx]


def grid_samples(x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike, value: ArrayLike, bin_m: float, keep: ArrayLike = True) -> Bins:
    """Mean, standard deviation and number of the samples `[n]` in each bin of `bin_m` metres.

    Bin i covers i * bin_m <= x < (i + 1) * bin_m, so its edges do not depend on the samples; each different `z_m` is a
    level of its own. Empty bins are NaN. Samples that `keep [n]` leaves out belong to the area all the same: they
    stretch the grid and count nowhere. `InputError` for no sample, values that are not finite, a bin size that is
    not positive, or a grid of more than 10 million bins.
    """
    x, y, z, values = (np.asarray(array, dtype=np.float64).ravel() for array in (x_m, y_m, z_m, value))
    if not np.isfinite(bin_m) or bin_m <= 0:
        raise InputError(f"the bin size is {bin_m:g} m; expected more than 0")
    if not values.size or not x.size == y.size == z.size == values.size:
        raise InputError(
            f"{values.size} value(s) at {x.size}, {y.size}, {z.size} x, y, z; expected at least one and as many of each"
        )
    if not all(np.isfinite(array).all() for array in (x, y, z, values)):
        raise InputError("a sample has a position or value that is not finite: drop it before gridding")
    (ix, x_centres), (iy, y_centres) = _bin_axis(x, bin_m), _bin_axis(y, bin_m)
    z_levels, iz = np.unique(z, return_inverse=True)
    shape = z_levels.size, y_centres.size, x_centres.size
    if shape[0] * shape[1] * shape[2] > MAX_CELLS:
        raise InputError(
            f"the samples span {np.ptp(x) / 1000:.4g} km x {np.ptp(y) / 1000:.4g} km, too many bins of {bin_m:g} m:"
            " remove stray positions or use larger bins"
        )
    kept = np.broadcast_to(np.asarray(keep, dtype=bool), values.shape)
    cell = (iz * shape[1] + iy) * shape[2] + ix
    mean, std, count = _statistics(cell[kept], values[kept], shape[0] * shape[1] * shape[2])
    return Bins(x_centres, y_centres, z_levels, mean.reshape(shape), std.reshape(shape), count.reshape(shape))


def _bin_axis(along_m: FloatArray, bin_m: float) -> tuple[NDArray[np.int64], FloatArray]:
    index = np.floor(along_m / bin_m).astype(np.int64)
    first, last = int(index.min()), int(index.max())
    if last - first >= MAX_CELLS:
        raise InputError(
            f"the samples span {np.ptp(along_m) / 1000:.4g} km: remove stray positions or use bins above {bin_m:g} m"
        )
    return index - first, np.asarray((np.arange(first, last + 1) + 0.5) * bin_m)


def _statistics(cell: NDArray[np.int64], values: FloatArray, n_cells: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    # Rounding depends on the order of a sum; sorted values have only one.
    order = np.lexsort((values, cell))
    cell, values = cell[order], values[order]
    count = np.bincount(cell, minlength=n_cells)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(cell, weights=values, minlength=n_cells) / count
        squares = np.bincount(cell, weights=(values - mean[cell]) ** 2, minlength=n_cells)
        std = np.sqrt(np.where(count > 1, squares / (count - 1), np.nan))
    return mean, std, count.astype(np.int32)
