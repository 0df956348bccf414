"""How the errors of cells hang together after the measurements of a Gaussian process: its posterior, to draw whole maps from.

Up to `EXACT_CELLS` cells it is the posterior itself, as one factor. Beyond, the same measurements condition a process whose
correlation is a product over the axes, exp(-distance / length) along each, with the same constants: nothing dense over cells.
"""

import json
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.estimate.correlation import Field, FloatArray, Measured, axis_factors, shared_rows
from cellpilot.maps.estimate.gaussian_process import GaussianProcess, Kernel
from cellpilot.maps.estimate.local import EXACT_POINTS

EXACT_CELLS = 2_000
"""A factor of so many cells takes 16 MB, and a draw reads all of it."""
MOST_POSTERIOR_CELLS = 100_000
"""Beyond, their standard deviations given 1,500 measured cells take more than some ten seconds."""
AT_ONCE = 2_000


def too_large(n_cells: int, n_measured: int) -> str | None:
    """Why the posterior of so many cells is not drawn from; None if it is."""
    if n_cells <= EXACT_CELLS or (n_cells <= MOST_POSTERIOR_CELLS and n_measured <= EXACT_POINTS):
        return None
    return (
        f"{n_cells} cells, {n_measured} of them measured, are too many to draw from the posterior"
        f" (at most {EXACT_CELLS} cells, or {MOST_POSTERIOR_CELLS} with {EXACT_POINTS} measured)"
    )


def kernel_text(kernel: Kernel) -> str:
    """The attribute `fill_kernel` of a map."""
    return json.dumps(asdict(kernel), sort_keys=True)


def parsed_kernel(text: str) -> Kernel:
    """The kernel in the attribute `fill_kernel`; `InputError` if it is none."""
    try:
        values = json.loads(text)
        spreads = [values[name] for name in ("offset_std_db", "height_offset_std_db", "noise_std_db")]
        if not all(np.isfinite(value) and value >= 0 for value in spreads):
            raise ValueError(f"{spreads} are not finite and at least 0")
        return Kernel(**values)
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise InputError(
            f"the attribute fill_kernel is no kernel of a Gaussian process ({error!r:.80}); fill the map again, or remove it"
        ) from None


def posterior(grid: Grid, kernel: Kernel, cells: NDArray[np.intp], count: FloatArray) -> Field:
    """The posterior after `count [measured]` measurements of each of the `cells [measured]`.

    `InputError` for a map that is too large, and beyond `EXACT_CELLS` cells for another form than the exponential.
    """
    reason = too_large(grid.n_cells, len(cells))
    if reason is not None:
        raise InputError(f"{reason}: remove the attribute fill_kernel")
    if grid.n_cells <= EXACT_CELLS:
        return _exact(grid, kernel, cells, count)
    if kernel.form != "exponential":
        raise InputError(f"fill_kernel has the form {kernel.form!r}; expected 'exponential' for more than {EXACT_CELLS} cells")
    return _conditioned(grid, kernel, cells, count)


def _exact(grid: Grid, kernel: Kernel, cells: NDArray[np.intp], count: FloatArray) -> Field:
    n = grid.n_cells
    process = GaussianProcess(kernel, grid.metres(np.arange(n)), 0.0)
    counts = np.zeros(n)
    counts[cells] = count
    process.update_means(counts, np.zeros(n))
    factor = process.root()
    return Field((factor, np.eye(1), np.eye(1)), np.linalg.norm(factor, axis=1), None, None)


def _conditioned(grid: Grid, kernel: Kernel, cells: NDArray[np.intp], count: FloatArray) -> Field:
    """The field is L T X n: L and T of the prior, X X^T = I - A^T (I + A A^T)^-1 A with A = N^-1/2 (L T) in the measured cells.

    X = I - A^T C^-T (C + I)^-1 A with the lower factor C of I + A A^T (Andrews 1968, A square root formulation of the Kalman
    covariance equations); N is the noise. All in units of the standard deviation of the random field.
    """
    points_m, n, m = grid.metres(np.arange(grid.n_cells)), grid.n_cells, len(cells)
    lengths_m = (kernel.length_m, kernel.length_m, kernel.vertical_length_m)
    offset, height_offset = kernel.offset_std_db / kernel.std_db, kernel.height_offset_std_db / kernel.std_db
    factors = axis_factors(grid, lengths_m)
    constants = np.concatenate(
        [np.full((1, n), offset), height_offset * (points_m[:, 2] == np.array(grid.z_m)[:, None])], dtype=np.float64
    )

    def covariance(of: FloatArray) -> FloatArray:
        near = np.exp(-sum(np.abs(of[:, None, i] - points_m[cells][None, :, i]) / lengths_m[i] for i in range(3)))
        return np.asarray(near + offset**2 + height_offset**2 * (of[:, None, 2] == points_m[cells][None, :, 2]))

    weight = kernel.std_db / np.sqrt(kernel.measurement_variance(count))
    root = cholesky(np.eye(m) + weight[:, None] * covariance(points_m[cells]) * weight, lower=True)
    gain = solve_triangular(root, solve_triangular(root + np.eye(m), np.eye(m), lower=True), lower=True, trans="T")
    variance = np.empty(n)
    for first in range(0, n, AT_ONCE):
        some = slice(first, first + AT_ONCE)
        known = solve_triangular(root, weight[:, None] * covariance(points_m[some]).T, lower=True)
        variance[some] = 1.0 + offset**2 + height_offset**2 - (known**2).sum(0)
    number = np.full(n, m)
    number[cells] = np.arange(m)
    gain = np.concatenate([weight[:, None] * gain * weight, np.zeros((1, m))])
    return Field(factors, np.sqrt(variance), shared_rows(factors, constants), Measured(cells, number, gain))
