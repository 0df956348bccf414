"""The Gaussian process by neighbourhoods against the exact one, and the exact one against scikit-learn."""

import numpy as np
import pytest
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern

from cellpilot.maps.estimate import local
from cellpilot.maps.estimate.gaussian_process import GaussianProcess, Kernel, Measurements, interpolate
from cellpilot.maps.estimate.local import EXACT_POINTS, interpolate_locally

NU = {"exponential": 0.5, "matern-3/2": 1.5, "matern-5/2": 2.5}


def measured(points_m: np.ndarray, rng: np.random.Generator, most: int = 4) -> Measurements:
    """Up to `most` measurements of each point, random means."""
    n = len(points_m)
    return Measurements(points_m, rng.integers(1, most + 1, n).astype(float), rng.normal(2.0, 6.0, n), np.zeros(n))


def plane(n: int, height_m: float = 30.0, step_m: float = 20.0) -> np.ndarray:
    """Points `[n * n, 3]` of one height."""
    x, y = np.meshgrid(*(step_m * np.arange(n),) * 2)
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, height_m)], axis=-1)


def surface_db(points_m: np.ndarray) -> np.ndarray:
    """A slope as prior mean, so that a prior of the wrong point shows."""
    return points_m[:, 0] / 30 - points_m[:, 1] / 50


@pytest.mark.parametrize("form", list(NU))
@pytest.mark.parametrize("heights_m", [(20.0, 50.0, 80.0), (30.0,)])
def test_the_exact_posterior_is_that_of_scikit_learn(form: str, heights_m: tuple[float, ...]) -> None:
    rng = np.random.default_rng(5)
    places_m = np.column_stack([rng.uniform(0, 300, (90, 2)), rng.choice(heights_m, 90)])
    # scikit-learn has no kernel of equal heights: at a single one its constant is added to the other.
    own_db = 4.0 if len(heights_m) == 1 else 0.0
    kernel = Kernel(5.0, 70.0, 35.0, offset_std_db=8.0, height_offset_std_db=own_db, noise_std_db=1.5, form=form)  # type: ignore[arg-type]
    known, targets_m = measured(places_m[:60], rng), places_m[60:]
    mean_db, std_db = interpolate(kernel, known, targets_m, surface_db(targets_m), surface_db(known.points_m))
    theirs = GaussianProcessRegressor(
        ConstantKernel(5.0**2) * Matern([70.0, 70.0, 35.0], nu=NU[form]) + ConstantKernel(8.0**2 + own_db**2),
        alpha=1.5**2 / known.count,
        optimizer=None,
    ).fit(known.points_m, known.mean_db - surface_db(known.points_m))
    expected_db, expected_std_db = theirs.predict(targets_m, return_std=True)
    np.testing.assert_allclose(mean_db, expected_db + surface_db(targets_m), atol=1e-6)
    np.testing.assert_allclose(std_db, expected_std_db, atol=1e-6)


def test_a_neighbourhood_of_all_points_is_exact(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(6)
    known = measured(np.concatenate([plane(9, 30.0), plane(9, 60.0)]), rng)
    targets_m = np.column_stack([rng.uniform(0, 160, (50, 2)), rng.uniform(20, 70, 50)])
    priors = surface_db(targets_m), surface_db(known.points_m)
    exact = interpolate(Kernel(), known, targets_m, *priors)
    for name, value in {"EXACT_POINTS": 0, "NEIGHBOURS": len(known.mean_db), "TARGETS": 7}.items():
        monkeypatch.setattr(local, name, value)
    np.testing.assert_allclose(interpolate_locally(Kernel(), known, targets_m, *priors), exact, atol=1e-8)


@pytest.mark.parametrize("targets", ["dense", "scattered", "at the corners"])
def test_nearest_measurements_say_what_all_of_them_say(targets: str) -> None:
    """However few and far apart the targets are: each needs measurements near itself, not near their middle."""
    rng = np.random.default_rng(8)
    points_m = plane(40)
    assert len(points_m) > EXACT_POINTS
    kernel = Kernel(5.0, 60.0, noise_std_db=1.0)
    known = measured(points_m, rng)
    targets_m = {
        "dense": plane(24, step_m=10.0) + np.array([3.0, 4.0, 0.0]),
        "scattered": np.column_stack([rng.uniform(0, 780, (40, 2)), np.full(40, 30.0)]),
        "at the corners": np.array([(x, y, 30.0) for x in (5.0, 775.0) for y in (5.0, 775.0)]),
    }[targets]
    priors = surface_db(targets_m), surface_db(points_m)
    (mean_db, std_db), (exact_db, exact_std_db) = (
        f(kernel, known, targets_m, *priors) for f in (interpolate_locally, interpolate)
    )
    assert np.abs(mean_db - exact_db).max() < 0.1
    np.testing.assert_allclose(std_db, exact_std_db, rtol=0.01)
    # Fewer measurements never make a Gaussian process surer.
    assert (std_db > exact_std_db - 1e-9).all()


def test_near_is_what_is_correlated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where SINR hardly changes with height, the nearest measurements of a hole are those above it, 400 m away."""
    rng = np.random.default_rng(9)
    kernel = Kernel(6.0, 40.0, 8_000.0, height_offset_std_db=0.1, noise_std_db=0.1)
    low_m, high_m = plane(20, 30.0), plane(20, 430.0)
    hole = np.abs(low_m[:, :2] - 190).max(axis=1) < 60
    points_m = np.concatenate([low_m[~hole], high_m])
    field_db = GaussianProcess(kernel, np.concatenate([points_m, low_m[hole]]), 0.0).sample(rng)
    known = Measurements(points_m, np.ones(len(points_m)), field_db[: len(points_m)], np.zeros(len(points_m)))
    monkeypatch.setattr(local, "EXACT_POINTS", 0)
    monkeypatch.setattr(local, "NEIGHBOURS", 120)
    error_db = interpolate_locally(kernel, known, low_m[hole])[0] - field_db[len(points_m) :]
    assert np.sqrt(np.mean(error_db**2)) < 2.0


def test_the_order_of_the_targets_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(10)
    known = measured(plane(12), rng)
    targets_m = np.column_stack([rng.uniform(0, 220, (80, 2)), np.full(80, 30.0)])
    order = rng.permutation(80)
    for name, value in {"EXACT_POINTS": 0, "NEIGHBOURS": 60, "TARGETS": 9}.items():
        monkeypatch.setattr(local, name, value)
    straight = np.array(interpolate_locally(Kernel(), known, targets_m, surface_db(targets_m)))
    mixed = np.array(interpolate_locally(Kernel(), known, targets_m[order], surface_db(targets_m[order])))
    np.testing.assert_allclose(mixed, straight[:, order], atol=1e-9)


def test_no_target_is_no_answer() -> None:
    rng = np.random.default_rng(11)
    for n in (3, 40):
        mean_db, std_db = interpolate_locally(Kernel(), measured(plane(n), rng), np.empty((0, 3)))
        assert mean_db.shape == std_db.shape == (0,)


def test_progress_rises_to_one(monkeypatch: pytest.MonkeyPatch) -> None:
    known = measured(plane(12), np.random.default_rng(12))
    shares: list[float] = []
    for name, value in {"EXACT_POINTS": 0, "NEIGHBOURS": 60, "TARGETS": 9}.items():
        monkeypatch.setattr(local, name, value)
    interpolate_locally(Kernel(), known, plane(6), progress=shares.append)
    assert len(shares) >= 4
    assert shares[0] > 0
    assert (np.diff(shares) > 0).all()
    assert shares[-1] == 1.0
