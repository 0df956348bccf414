"""Normal fields over the cells of a grid whose correlation is the product over the axes of exp(-distance / length).

Arithmetic only in what draws (`along_axes`), so that traced arrays go through it as well.
"""

from typing import Any, NamedTuple

import numpy as np
from scipy.linalg import solve_triangular

from cellpilot.array_types import FloatArray
from cellpilot.grid import Grid

Factors = tuple[Any, Any, Any]
"""A square matrix for each of x, y, z."""

CORRELATION_M = 50.0
"""Distance over which the error of a map falls to 1/e where its source states none [m]: the correlation distance of shadow
fading without line of sight in a city (3GPP TR 38.901 Table 7.5-6, UMa NLOS)."""


class Measured(NamedTuple):
    """The measurements that a drawn field is conditioned on."""

    cells: Any  # [measured]
    number: Any  # [n_cells] in `cells`; `measured` for a cell without measurements
    gain: Any  # [measured + 1, measured] weights of the drawn values, a last row of zeros


class Field(NamedTuple):
    """A normal field over the cells, of standard deviation `std [n_cells]`, by what draws it."""

    factors: Factors
    std: FloatArray
    shared: FloatArray | None
    measured: Measured | None


def axis_factors(grid: Grid, lengths_m: tuple[float, float, float]) -> Factors:
    """Lower triangular factor of the correlation along x, y and z; a length of 0 m leaves each cell for itself."""
    axes_m = (grid.x_m, grid.y_m, grid.z_m)
    x, y, z = (_factor(axis_m, length_m) for axis_m, length_m in zip(axes_m, lengths_m, strict=True))
    return x, y, z


def along_axes(field: Any, factors: Factors) -> Any:
    """The product of the factors of all axes with fields `[..., n_cells]`."""
    x, y, z = factors
    cube = field.reshape((*field.shape[:-1], len(z), len(y), len(x))) @ x.T
    cube = (cube.swapaxes(-1, -2) @ y.T).swapaxes(-1, -2)
    cube = (cube.swapaxes(-1, -3) @ z.T).swapaxes(-1, -3)
    return cube.reshape(field.shape)


def transposed(factors: Factors) -> Factors:
    """The transposed factors."""
    x, y, z = factors
    return x.T, y.T, z.T


def shared_rows(factors: Factors, terms: FloatArray) -> FloatArray:
    """Rows A `[terms, n_cells]`: of normal numbers n, L (n + A^T A n) has the covariance L L^T + terms^T terms.

    L are the factors. With V = L^-1 terms^T, I + A^T A is the symmetric square root of I + V V^T.
    """
    x, y, z = (solve_triangular(factor, np.eye(len(factor)), lower=True) for factor in factors)
    _, size, directions = np.linalg.svd(along_axes(terms, (x, y, z)), full_matrices=False)
    return np.asarray(np.sqrt(np.sqrt(1.0 + size**2) - 1.0)[:, None] * directions)


def _factor(axis_m: tuple[float, ...], length_m: float) -> FloatArray:
    """Of one axis: a first-order autoregression, so it is exact."""
    n = len(axis_m)
    if not length_m:
        return np.eye(n)
    kept = np.exp(-np.diff(np.asarray(axis_m, np.float64)) / length_m)
    factor = np.zeros((n, n))
    factor[0, 0] = 1.0
    for i in range(1, n):
        factor[i] = kept[i - 1] * factor[i - 1]
        factor[i, i] = np.sqrt(1.0 - kept[i - 1] ** 2)
    return factor
