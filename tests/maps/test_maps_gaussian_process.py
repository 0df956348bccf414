"""The Gaussian process against a plain dense solution, its own definition and known fields."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.maps.estimate.gaussian_process import (
    FORMS,
    GaussianProcess,
    Kernel,
    Measurements,
    estimate_kernel,
    interpolate,
)


def lattice(nx: int, ny: int, nz: int, step_m: float = 20.0) -> np.ndarray:
    """Points `[n, 3]` of a grid."""
    x, y, z = np.meshgrid(*(step_m * np.arange(n) for n in (nx, ny, nz)), indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)


def plain_covariance(kernel: Kernel, a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """The definition, pair by pair."""
    result = np.empty((len(a), len(b)))
    for i, p in enumerate(a):
        for j, q in enumerate(b):
            flat = np.hypot(p[0] - q[0], p[1] - q[1]) / kernel.length_m
            d = np.hypot(flat, (p[2] - q[2]) / kernel.vertical_length_m)
            rho = {
                "exponential": np.exp(-d),
                "matern-3/2": (1 + np.sqrt(3) * d) * np.exp(-np.sqrt(3) * d),
                "matern-5/2": (1 + np.sqrt(5) * d + 5 * d**2 / 3) * np.exp(-np.sqrt(5) * d),
            }[kernel.form]
            result[i, j] = kernel.std_db**2 * rho + kernel.offset_std_db**2 + (p[2] == q[2]) * kernel.height_offset_std_db**2
    return result


def dense(
    kernel: Kernel, points_m: np.ndarray, prior_db: np.ndarray, index: np.ndarray, values_db: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the posterior, one row per measurement, by solving linear systems."""
    at = points_m[index]
    innovation = plain_covariance(kernel, at, at) + kernel.noise_std_db**2 * np.eye(len(at))
    gain = np.linalg.solve(innovation, plain_covariance(kernel, at, points_m)).T
    mean = prior_db + gain @ (values_db - prior_db[index])
    return mean, plain_covariance(kernel, points_m, points_m) - gain @ plain_covariance(kernel, at, points_m)


@settings(max_examples=15)
@given(
    st.integers(0, 2**31),
    st.sampled_from(list(FORMS)),
    st.sampled_from([(5, 4, 1), (3, 3, 3)]),
    st.sampled_from([0.1, 2.0]),
    st.integers(1, 9),
)
def test_updates_equal_a_dense_solution(seed: int, form: str, sides: tuple[int, int, int], noise_db: float, step: int) -> None:
    """Measurements one by one or in blocks, with repeats of a point within and between blocks."""
    rng = np.random.default_rng(seed)
    points_m = lattice(*sides)
    kernel = Kernel(5.0, 70.0, 30.0, offset_std_db=8.0, height_offset_std_db=3.0, noise_std_db=noise_db, form=form)  # type: ignore[arg-type]
    prior_db = rng.normal(3.0, 5.0, len(points_m))
    index = rng.integers(0, len(points_m) // 2, 40)
    values_db = rng.normal(0.0, 8.0, 40)
    process = GaussianProcess(kernel, points_m, prior_db)
    for i in range(0, 40, step):
        process.update(index[i : i + step], values_db[i : i + step])
    mean_db, covariance_db2 = dense(kernel, points_m, prior_db, index, values_db)
    np.testing.assert_allclose(process.mean_db, mean_db, atol=1e-6)
    np.testing.assert_allclose(process.covariance_db2, covariance_db2, atol=1e-6)
    np.testing.assert_allclose(process.std_db, np.sqrt(np.diagonal(covariance_db2)), atol=1e-5)


def test_the_multiple_of_a_trend_is_found_by_regression() -> None:
    """With next to no random field, mean and covariance of the weight are those of Bayesian linear regression."""
    rng = np.random.default_rng(2)
    points_m = lattice(6, 5, 1)
    trend_db = rng.normal(0.0, 6.0, (30, 1))
    kernel = Kernel(1e-3, 50.0, offset_std_db=0.0, height_offset_std_db=0.0, noise_std_db=1.0)
    process = GaussianProcess(kernel, points_m, 2.0, trend_db)
    index = rng.integers(0, 30, 12)
    values_db = 2.0 + 0.7 * trend_db[index, 0] + rng.standard_normal(12)
    process.update(index, values_db)
    precision = 1 + (trend_db[index] ** 2).sum()
    weight = (trend_db[index, 0] @ (values_db - 2.0)) / precision
    np.testing.assert_allclose(process.mean_db, 2.0 + weight * trend_db[:, 0], atol=1e-3)
    np.testing.assert_allclose(process.std_db, np.abs(trend_db[:, 0]) / np.sqrt(precision), atol=2e-3)
    # Told of the trend, the estimate needs no field to explain it.
    measured = Measurements.of(points_m[index], values_db)
    place = {tuple(point): i for i, point in enumerate(points_m)}
    at = [place[tuple(point)] for point in measured.points_m]
    with_trend, without = (estimate_kernel(measured, 2.0, Kernel(), t) for t in (trend_db[at], None))
    assert with_trend.std_db < 0.6 * without.std_db


def test_interpolation_between_points_equals_a_dense_solution() -> None:
    rng = np.random.default_rng(4)
    kernel = Kernel(5.0, 60.0, 40.0, noise_std_db=1.5)
    places_m = rng.uniform(0, 200, (12, 3))
    points_m = np.concatenate([places_m, rng.uniform(0, 200, (7, 3))])
    index = rng.integers(0, 12, 30)
    values_db = rng.normal(0, 6, 30)
    prior_db = points_m[:, 0] / 50
    measurements = Measurements.of(points_m[index], values_db)
    assert measurements.count.sum() == 30
    mean_db, std_db = interpolate(kernel, measurements, points_m, prior_db, measurements.points_m[:, 0] / 50)
    expected_db, covariance_db2 = dense(kernel, points_m, prior_db, index, values_db)
    np.testing.assert_allclose(mean_db, expected_db, atol=1e-6)
    np.testing.assert_allclose(std_db**2, np.diagonal(covariance_db2), atol=1e-6)


def log_density(kernel: Kernel, points_m: np.ndarray, values_db: np.ndarray) -> float:
    """Logarithm of the density of single measurements, up to a constant, by its definition."""
    covariance = plain_covariance(kernel, points_m, points_m) + kernel.noise_std_db**2 * np.eye(len(points_m))
    return -0.5 * (values_db @ np.linalg.solve(covariance, values_db) + np.linalg.slogdet(covariance)[1])


def log_belief(kernel: Kernel, medians: Kernel) -> float:
    """Logarithm of the weak prior."""
    spreads = {"std_db": 0.7, "length_m": 0.7, "vertical_length_m": 0.7, "noise_std_db": 1.5}
    return sum(-0.5 * (np.log(getattr(kernel, n) / getattr(medians, n)) / s) ** 2 for n, s in spreads.items())


@pytest.mark.parametrize("form", list(FORMS))
def test_the_estimate_is_a_maximum_of_the_posterior_density(form: str) -> None:
    """No hyper-parameter moved by 3 % makes the measurements, repeats among them, more likely."""
    rng = np.random.default_rng(7)
    points_m = lattice(6, 6, 2)
    truth = Kernel(5.0, 80.0, 40.0, noise_std_db=2.0, form=form)  # type: ignore[arg-type]
    field_db = GaussianProcess(truth, points_m, 0.0).sample(rng)
    index = rng.integers(0, len(points_m), 90)
    values_db = field_db[index] + 2 * rng.standard_normal(90)
    start = Kernel(form=form)  # type: ignore[arg-type]
    found = estimate_kernel(Measurements.of(points_m[index], values_db), 0.0, start)

    def quality(kernel: Kernel) -> float:
        return log_density(kernel, points_m[index], values_db) + log_belief(kernel, start)

    best = quality(found)
    for name in ("std_db", "length_m", "vertical_length_m", "noise_std_db"):
        for factor in (0.97, 1.03):
            assert quality(replace(found, **{name: factor * getattr(found, name)})) < best + 1e-3, (name, factor)
    assert (found.offset_std_db, found.height_offset_std_db, found.form) == (10.0, 5.0, form)


@pytest.mark.parametrize("noise_db", [0.0, 2.0])
def test_hyper_parameters_of_a_known_field_are_found(noise_db: float) -> None:
    rng = np.random.default_rng(1)
    points_m = lattice(30, 30, 1)
    truth = Kernel(4.0, 50.0, form="matern-3/2")
    field_db = 17.0 + GaussianProcess(replace(truth, offset_std_db=0.0, height_offset_std_db=0.0), points_m, 0.0).sample(rng)
    index = rng.integers(0, len(points_m), 700)
    measurements = Measurements.of(points_m[index], field_db[index] + noise_db * rng.standard_normal(700))
    found = estimate_kernel(measurements, 0.0, Kernel(form="matern-3/2"))
    assert found.std_db == pytest.approx(4.0, rel=0.35)
    assert found.length_m == pytest.approx(50.0, rel=0.35)
    assert found.noise_std_db == pytest.approx(max(noise_db, 0.1), rel=0.2, abs=0.15)


def test_a_prior_map_that_is_right_but_for_a_constant_leaves_only_that_to_find() -> None:
    points_m = lattice(10, 10, 2)
    truth_db = 5 * np.sin(points_m[:, 0] / 60) + points_m[:, 2] / 10
    prior_db = truth_db - 12.0
    process = GaussianProcess(Kernel(0.5, 60.0, noise_std_db=0.5), points_m, prior_db)
    process.update([3, 77, 140], truth_db[[3, 77, 140]])
    assert np.abs(process.mean_db - truth_db).max() < 1.0
    unknown = GaussianProcess(Kernel(0.5, 60.0), points_m, prior_db).std_db
    assert unknown == pytest.approx(np.sqrt(10**2 + 5**2 + 0.5**2))


def test_heights_have_their_own_constant() -> None:
    """What is measured at one height says little about the level of another, and much about far places of its own."""
    points_m = lattice(2, 1, 2, step_m=1000.0)
    process = GaussianProcess(
        Kernel(1.0, 50.0, 50.0, offset_std_db=1.0, height_offset_std_db=10.0, noise_std_db=0.1), points_m, 0.0
    )
    process.update([0], [20.0])  # (0, 0, 0)
    by_place = dict(zip(map(tuple, points_m.tolist()), process.mean_db, strict=True))
    assert by_place[(1000.0, 0.0, 0.0)] > 19
    assert abs(by_place[(0.0, 0.0, 1000.0)]) < 1


def test_samples_have_the_mean_and_covariance_of_the_posterior() -> None:
    points_m = lattice(3, 2, 1)
    process = GaussianProcess(Kernel(4.0, 50.0, offset_std_db=2.0, noise_std_db=0.1), points_m, 3.0)
    process.update([0, 0, 4], [9.0, 9.2, -3.0])
    draws = np.array([process.sample(rng) for rng in map(np.random.default_rng, range(4000))])
    error = 5 / np.sqrt(len(draws))
    assert (np.abs(draws.mean(0) - process.mean_db) < error * process.std_db + 1e-3).all()
    np.testing.assert_allclose(np.cov(draws.T), process.covariance_db2, atol=4 * error * process.std_db.max() ** 2)


@pytest.mark.parametrize("bad", [{"std_db": 0.0}, {"length_m": -1.0}, {"vertical_length_m": np.nan}, {"form": "cubic"}])
def test_impossible_kernels_are_refused(bad: dict) -> None:
    with pytest.raises(InputError, match="expected"):
        Kernel(**bad)
