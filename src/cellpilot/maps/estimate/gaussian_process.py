"""A Gaussian process of SINR: what is known of every place after noisy measurements of some, and how well.

SINR at a point = prior mean + an unknown constant + an unknown constant of the height + unknown multiples of given
trends + a random field. Constants and multiples are Gaussian with a wide spread, so they are estimated with everything
else and their uncertainty is carried along (Rasmussen and Williams, Gaussian Processes for Machine Learning, section
2.7). The field is stationary; its covariance falls with the distance, horizontal and vertical metres measured in their
own correlation lengths. Hyper-parameters are those of the highest marginal likelihood (section 5.4.1 there), times a
weak prior that decides while data are few.
"""

from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, solve_triangular
from scipy.optimize import minimize

from cellpilot.array_types import FloatArray, IndexArray
from cellpilot.errors import InputError

KernelForm = Literal["exponential", "matern-3/2", "matern-5/2"]

SMALLEST_NOISE_DB = 0.1
"""Smallest standard deviation of a measurement: below it rounding would decide."""
LARGEST_FIT = 400
"""Hyper-parameters are estimated from at most so many points, drawn evenly from all: the work grows with the cube."""


def _exponential(distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    fall = np.exp(-distance)
    return fall, -fall


def _matern_3_2(distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    scaled = np.sqrt(3) * distance
    fall = np.exp(-scaled)
    return (1 + scaled) * fall, -np.sqrt(3) * scaled * fall


def _matern_5_2(distance: FloatArray) -> tuple[FloatArray, FloatArray]:
    scaled = np.sqrt(5) * distance
    fall = np.exp(-scaled)
    return (1 + scaled + scaled**2 / 3) * fall, -np.sqrt(5) / 3 * scaled * (1 + scaled) * fall


FORMS = {"exponential": _exponential, "matern-3/2": _matern_3_2, "matern-5/2": _matern_5_2}
"""Correlation and its derivative at a distance in correlation lengths (Rasmussen and Williams, equations 4.16-4.18)."""


@dataclass(frozen=True)
class Kernel:
    """Hyper-parameters of the process; the defaults are ordinary for SINR above a town (3GPP shadowing: 4-8 dB, 37-120 m)."""

    std_db: float = 6.0  # of the random field
    length_m: float = 60.0  # horizontal distance at which the correlation has fallen to 1/e (exponential form)
    vertical_length_m: float = 60.0
    offset_std_db: float = 10.0  # of the constant common to all points
    height_offset_std_db: float = 5.0  # of the constant of each height; without effect where all points share one
    noise_std_db: float = 1.0  # of one measurement
    form: KernelForm = "exponential"

    def __post_init__(self) -> None:
        if self.form not in FORMS:
            raise InputError(f"the form of the kernel is {self.form!r}; expected one of {', '.join(FORMS)}")
        positive = (self.std_db, self.length_m, self.vertical_length_m)
        if not all(np.isfinite(value) and value > 0 for value in positive):
            raise InputError(f"std_db, length_m and vertical_length_m are {positive}; expected finite values above 0")

    @property
    def variance(self) -> float:
        """Variance of SINR at any point before the first measurement [dB^2]."""
        return self.std_db**2 + self.offset_std_db**2 + self.height_offset_std_db**2

    def covariance(self, points_m: FloatArray, others_m: FloatArray) -> FloatArray:
        """Covariance `[points, others]` [dB^2] between points `[..., 3]` given as (x, y, z) [m]."""
        correlation, _ = FORMS[self.form](_Distances.between(points_m, others_m).scaled(self))
        same_height = points_m[:, None, 2] == others_m[None, :, 2]
        return self.std_db**2 * correlation + self.offset_std_db**2 + self.height_offset_std_db**2 * same_height

    def measurement_variance(self, count: ArrayLike = 1) -> FloatArray:
        """Variance of the mean of `count` measurements of one point [dB^2]."""
        return np.asarray(max(self.noise_std_db, SMALLEST_NOISE_DB) ** 2 / np.asarray(count, dtype=np.float64))


class _Distances(NamedTuple):
    """Squared distances between points [m^2]."""

    horizontal: FloatArray
    vertical: FloatArray

    @classmethod
    def between(cls, points_m: FloatArray, others_m: FloatArray) -> "_Distances":
        """Of every point to every other one."""
        squared = (points_m[:, None, :] - others_m[None, :, :]) ** 2
        return cls(squared[..., 0] + squared[..., 1], squared[..., 2])

    def scaled(self, kernel: Kernel) -> FloatArray:
        """Distance in correlation lengths."""
        return np.asarray(np.sqrt(self.horizontal / kernel.length_m**2 + self.vertical / kernel.vertical_length_m**2))


@dataclass(frozen=True)
class Measurements:
    """Measurements of points, those of the same point put together: nothing is lost, for the noise is Gaussian."""

    points_m: FloatArray  # [points, 3] all different
    count: FloatArray  # [points] measurements of each
    mean_db: FloatArray  # [points]
    squares_db2: FloatArray  # [points] sum of squared deviations from the mean

    @classmethod
    def of(cls, points_m: FloatArray, values_db: FloatArray) -> "Measurements":
        """From one row per measurement: `points_m [measurements, 3]`, `values_db [measurements]`."""
        unique_m, index = np.unique(np.asarray(points_m, dtype=np.float64), axis=0, return_inverse=True)
        count, mean_db, squares_db2 = combine(index.ravel(), np.asarray(values_db, dtype=np.float64), len(unique_m))
        return cls(unique_m, count, mean_db, squares_db2)


def combine(index: IndexArray, values: FloatArray, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Number, mean (0 where there is none) and sum of squared deviations of the values of each index `0..n-1`."""
    count = np.bincount(index, minlength=n).astype(np.float64)
    mean = np.bincount(index, values, minlength=n) / np.maximum(count, 1)
    squares = np.bincount(index, (values - mean[index]) ** 2, minlength=n)
    return count, mean, np.asarray(squares, dtype=np.float64)


class GaussianProcess:
    """The posterior at a fixed set of points, such as the cells of a grid: mean, covariance, and their update.

    Memory and time of an update grow with the square of the number of points (2,000 points: 32 MB, some 10 ms for one
    measurement, hardly more for twenty at once).
    """

    def __init__(
        self, kernel: Kernel, points_m: FloatArray, prior_mean_db: ArrayLike, trends_db: FloatArray | None = None
    ) -> None:
        """Before any measurement; each of `trends_db [points, trends]` is added with an unknown standard normal weight."""
        self.kernel = kernel
        self.points_m = np.asarray(points_m, dtype=np.float64)
        self.mean_db: FloatArray = np.broadcast_to(np.asarray(prior_mean_db, dtype=np.float64), len(self.points_m)).copy()
        self.covariance_db2: FloatArray = kernel.covariance(self.points_m, self.points_m)
        if trends_db is not None:
            self.covariance_db2 += trends_db @ trends_db.T

    @property
    def std_db(self) -> FloatArray:
        """Standard deviation of SINR at each point, measurement noise excluded."""
        return np.asarray(np.sqrt(np.maximum(np.diagonal(self.covariance_db2), 0.0)))

    def update(self, index: ArrayLike, values_db: ArrayLike) -> None:
        """Condition on measurements of the points `index [measurements]`; a point may be measured again and again."""
        index = np.atleast_1d(np.asarray(index, dtype=np.intp))
        count, mean_db, _ = combine(index, np.atleast_1d(np.asarray(values_db, dtype=np.float64)), len(self.points_m))
        self.update_means(count, mean_db)

    def update_means(self, count: FloatArray, mean_db: FloatArray) -> None:
        """Condition on the means `[points]` of `count [points]` measurements of each point; nothing where that is 0."""
        at = np.flatnonzero(count)
        if not at.size:
            return
        innovation = self.covariance_db2[np.ix_(at, at)] + np.diag(self.kernel.measurement_variance(count[at]))
        root = cholesky(innovation, lower=True, check_finite=False)
        gain = solve_triangular(root, self.covariance_db2[at], lower=True, check_finite=False)
        surprise = solve_triangular(root, mean_db[at] - self.mean_db[at], lower=True, check_finite=False)
        self.mean_db += surprise @ gain
        self.covariance_db2 -= gain.T @ gain

    def sample(self, rng: np.random.Generator) -> FloatArray:
        """One map `[points]` drawn from the posterior [dB]."""
        return self.mean_db + self.root() @ rng.standard_normal(len(self.mean_db))

    def root(self) -> FloatArray:
        """Lower factor `[points, points]` of the posterior covariance [dB]."""
        variance = np.diagonal(self.covariance_db2)
        # Measured points have next to no variance left: a little is added, so that rounding cannot make it negative.
        jitter = 1e-9 * max(self.kernel.variance, float(variance.max()))
        covariance_db2 = self.covariance_db2 + np.diag(np.full(len(variance), jitter))
        return np.asarray(cholesky(covariance_db2, lower=True, check_finite=False))


def interpolate(
    kernel: Kernel,
    measurements: Measurements,
    targets_m: FloatArray,
    prior_mean_db: ArrayLike = 0.0,
    prior_at_db: ArrayLike = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Mean and standard deviation [dB] of SINR at `targets_m [targets, 3]`, after measurements anywhere.

    `prior_mean_db` belongs to the targets, `prior_at_db` to the measured points.
    """
    between = kernel.covariance(measurements.points_m, targets_m)
    innovation = kernel.covariance(measurements.points_m, measurements.points_m)
    innovation[np.diag_indices_from(innovation)] += kernel.measurement_variance(measurements.count)
    root = cholesky(innovation, lower=True, check_finite=False)
    gain = solve_triangular(root, between, lower=True, check_finite=False)
    surprise = solve_triangular(root, measurements.mean_db - np.asarray(prior_at_db), lower=True, check_finite=False)
    variance = kernel.variance - (gain**2).sum(0)
    return np.asarray(prior_mean_db) + surprise @ gain, np.sqrt(np.maximum(variance, 0.0))


class Belief(NamedTuple):
    """Log-normal prior of a hyper-parameter: its median is that of the kernel given, this its spread."""

    name: str
    spread: float  # standard deviation of the natural logarithm
    least: float
    greatest: float


BELIEFS = (
    Belief("std_db", 0.7, 0.3, 40.0),
    Belief("length_m", 0.7, 5.0, 5_000.0),
    Belief("vertical_length_m", 0.7, 5.0, 5_000.0),
    Belief("noise_std_db", 1.5, SMALLEST_NOISE_DB, 20.0),
)
"""Estimated hyper-parameters. Weak: ten measurements along a flight outweigh them."""


def estimate_kernel(
    measurements: Measurements,
    prior_at_db: ArrayLike = 0.0,
    start: Kernel | None = None,
    trends_at_db: FloatArray | None = None,
) -> Kernel:
    """Standard deviation, correlation lengths and noise of the highest posterior density given the measurements.

    `start` (default `Kernel()`) gives the medians of the prior and what is not estimated: the spreads of the constants
    and the form. `prior_at_db [points]` and `trends_at_db [points, trends]` are prior mean and trends at the measured points.
    """
    start = Kernel() if start is None else start
    residual_db = measurements.mean_db - np.asarray(prior_at_db, dtype=np.float64)
    chosen = np.arange(len(residual_db))
    if len(chosen) > LARGEST_FIT:
        chosen = np.sort(np.random.default_rng(0).choice(chosen, LARGEST_FIT, replace=False))
    points_m = measurements.points_m[chosen]
    trends_db = np.zeros((len(residual_db), 1)) if trends_at_db is None else trends_at_db
    several_heights = bool(np.ptp(points_m[:, 2])) if len(points_m) else False
    beliefs = [b for b in BELIEFS if several_heights or b.name != "vertical_length_m"]
    median = np.log([max(getattr(start, b.name), b.least) for b in beliefs])
    spread = np.array([b.spread for b in beliefs])
    problem = _Evidence(
        names=[b.name for b in beliefs],
        start=start,
        distances=_Distances.between(points_m, points_m),
        same_height=points_m[:, None, 2] == points_m[None, :, 2],
        trends_db2=trends_db[chosen] @ trends_db[chosen].T,
        residual_db=residual_db[chosen],
        count=measurements.count[chosen],
        squares_db2=float(measurements.squares_db2.sum()),
        repeats=float((measurements.count - 1).sum()),
    )

    def objective(logs: FloatArray) -> tuple[float, FloatArray]:
        value, gradient = problem.negative_log(logs)
        off = (logs - median) / spread
        return value + 0.5 * float(off @ off), gradient + off / spread

    bounds = [(np.log(b.least), np.log(b.greatest)) for b in beliefs]
    found = minimize(objective, median, jac=True, method="L-BFGS-B", bounds=bounds, options={"maxiter": 40, "ftol": 1e-6})
    return replace(start, **dict(zip(problem.names, np.exp(found.x).tolist(), strict=True)))


@dataclass(frozen=True)
class _Evidence:
    """Negative log marginal likelihood and its gradient by the logarithms of the named hyper-parameters."""

    names: list[str]
    start: Kernel
    distances: _Distances
    same_height: NDArray[np.bool_]
    trends_db2: FloatArray
    residual_db: FloatArray
    count: FloatArray
    squares_db2: float  # within points, all of them: they speak of the noise alone
    repeats: float

    def kernel(self, logs: FloatArray) -> Kernel:
        """The kernel of these logarithms."""
        return replace(self.start, **dict(zip(self.names, np.exp(logs).tolist(), strict=True)))

    def negative_log(self, logs: FloatArray) -> tuple[float, FloatArray]:
        """Value and gradient (Rasmussen and Williams, equations 5.8 and 5.9)."""
        kernel = self.kernel(logs)
        distance = self.distances.scaled(kernel)
        correlation, slope = FORMS[kernel.form](distance)
        field = kernel.std_db**2 * correlation
        constants = kernel.offset_std_db**2 + kernel.height_offset_std_db**2 * self.same_height + self.trends_db2
        noise = kernel.measurement_variance(self.count)
        root = cho_factor(field + constants + np.diag(noise), lower=True, check_finite=False)
        weights = cho_solve(root, self.residual_db, check_finite=False)
        inverse = cho_solve(root, np.eye(len(weights)), check_finite=False)
        within = self.squares_db2 / kernel.measurement_variance().item()
        value = 0.5 * (self.residual_db @ weights + within) + np.log(np.diagonal(root[0])).sum()
        value += self.repeats * np.log(kernel.noise_std_db)
        sensitivity = inverse - np.outer(weights, weights)
        # d distance / d log length = -(part of the squared distance) / distance, 0 at distance 0
        by_distance = kernel.std_db**2 * slope / np.where(distance > 0, distance, 1.0)
        gradients = {
            "std_db": float((sensitivity * field).sum()),
            "length_m": -0.5 * float((sensitivity * by_distance * self.distances.horizontal).sum()) / kernel.length_m**2,
            "vertical_length_m": -0.5
            * float((sensitivity * by_distance * self.distances.vertical).sum())
            / kernel.vertical_length_m**2,
            "noise_std_db": float((np.diagonal(sensitivity) * noise).sum()) - within + self.repeats,
        }
        return float(value), np.array([gradients[name] for name in self.names])
