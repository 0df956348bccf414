"""Means, quantiles and 95 % intervals."""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

Z95 = 1.959963984540054
"""97.5 % quantile of the normal distribution."""


def t95(n: int) -> float:
    """97.5 % quantile of Student's distribution with n - 1 degrees of freedom: 12.7 for two values, 1.96 for thousands."""
    return float(stdtrit(n - 1, 0.975))


def half_interval(values: NDArray[np.floating], axis: int = -1) -> Any:
    """Half of the 95 % interval of a mean over some independent values, Student's; NaN for fewer than two."""
    n = values.shape[axis]
    if n < 2:
        return np.full(np.delete(values.shape, axis), np.nan)
    return t95(n) * values.std(axis, ddof=1) / np.sqrt(n)


def mean_interval(values: NDArray[np.floating]) -> tuple[float, float] | None:
    """95 % interval of a mean (Student's); None for fewer than two values."""
    if len(values) < 2:
        return None
    half = half_interval(values)
    return float(values.mean() - half), float(values.mean() + half)


def share_interval(successes: float, n: float) -> tuple[float, float]:
    """Wilson 95 % interval of a share; it stays within 0..1 even at the ends."""
    p, z2 = successes / n, Z95**2
    centre = (p + z2 / (2 * n)) / (1 + z2 / n)
    half = Z95 / (1 + z2 / n) * np.sqrt(p * (1 - p) / n + z2 / (4 * n * n))
    return float(max(0.0, centre - half)), float(min(1.0, centre + half))


def ratio_interval(numerator: NDArray[np.floating], denominator: NDArray[np.floating]) -> tuple[float, float] | None:
    """95 % interval of sum(numerator)/sum(denominator) over independent rows (linearised ratio estimator, Student's).

    None for fewer than two rows.
    """
    if len(numerator) < 2:
        return None
    ratio = numerator.sum() / denominator.sum()
    residual = (numerator - ratio * denominator) / denominator.mean()
    half = half_interval(residual)
    return float(ratio - half), float(ratio + half)


def weighted_quantile(values: NDArray[np.floating], weights: NDArray[np.floating], q: float) -> float | None:
    """Smallest value whose cumulative weight reaches the share `q`; None where there is no weight."""
    keep = weights > 0
    if not keep.any():
        return None
    order = np.argsort(values[keep], kind="stable")
    cumulative = np.cumsum(weights[keep][order])
    index = min(int(np.searchsorted(cumulative, q * cumulative[-1] * (1 - 1e-12))), len(order) - 1)
    return float(values[keep][order][index])
