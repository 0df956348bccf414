"""Hiding blocks of measurements: what is hidden, the figures by hand, and the methods on fields that are known."""

from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import import_logs
from cellpilot.maps.estimate.fill import measured_cells
from cellpilot.maps.estimate.gaussian_process import GaussianProcess, Kernel
from cellpilot.maps.estimate.holdout import block_holdout
from cellpilot.maps.estimate.methods import Estimate, Known, gaussian_process, height_mean, inverse_distance
from cellpilot.scenario import MeasuredMap

UKM = Path(__file__).parents[2].parent / "shared" / "data" / "ukm"


def known_cells(points_m: np.ndarray, mean_db: np.ndarray, n_samples: float = 1.0) -> Known:
    """Cells of `n_samples` equal samples each, without a trend."""
    n = len(points_m)
    return Known(np.asarray(points_m, float), np.asarray(mean_db, float), np.full(n, n_samples), np.zeros(n), np.zeros(n))


def lattice(n: int, heights_m: tuple[float, ...], step_m: float = 10.0) -> np.ndarray:
    """Centres `[cells, 3]`, negative ones too."""
    along_m = step_m * (np.arange(n) - n // 3) + step_m / 2
    z, y, x = np.meshgrid(heights_m, along_m, along_m, indexing="ij")
    return np.stack([x.ravel(), y.ravel(), z.ravel()], axis=-1)


class Listener:
    """A method that says the same everywhere and keeps what it was shown."""

    def __init__(self, mean_db: float = 0.0, std_db: float = 0.0, noise_std_db: float = 0.0) -> None:
        self.says = mean_db, std_db, noise_std_db
        self.heard: list[tuple[Known, np.ndarray, np.ndarray]] = []

    def __call__(self, known: Known, targets_m: np.ndarray, prior_db: np.ndarray) -> Estimate:
        self.heard.append((known, targets_m, prior_db))
        mean_db, std_db, noise_std_db = self.says
        return Estimate(np.full(len(targets_m), mean_db), np.full(len(targets_m), std_db), noise_std_db)


def blocks_of(points_m: np.ndarray, block_m: float) -> set[tuple[int, int]]:
    return {(int(x // block_m), int(y // block_m)) for x, y, _ in points_m.tolist()}


@pytest.mark.parametrize("share", [0.2, 0.5])
def test_blocks_are_hidden_whole_and_at_all_heights(share: float) -> None:
    points_m = lattice(19, (20.0, 30.0, 50.0))
    points_m = points_m[np.random.default_rng(0).random(len(points_m)) < 0.6]
    known = known_cells(points_m, points_m[:, 0])._replace(prior_db=points_m[:, 1])
    listener = Listener()
    block_holdout(known, {"it": listener}, block_m=40.0, hidden_share=share, splits=6)
    everywhere = blocks_of(points_m, 40.0)
    for seen, targets_m, prior_db in listener.heard:
        hidden = blocks_of(targets_m, 40.0)
        assert len(hidden) == round(share * len(everywhere))
        assert not hidden & blocks_of(seen.points_m, 40.0)
        assert sorted(map(tuple, [*seen.points_m, *targets_m])) == sorted(map(tuple, points_m))
        assert set(targets_m[:, 2]) == {20.0, 30.0, 50.0}
        # What belongs to a cell stays with it.
        assert (seen.mean_db == seen.points_m[:, 0]).all()
        assert (prior_db == targets_m[:, 1]).all()
    assert len({frozenset(blocks_of(targets_m, 40.0)) for _, targets_m, _ in listener.heard}) == 6


def test_every_method_is_shown_the_same_splits() -> None:
    known = known_cells(lattice(10, (30.0,)), np.zeros(100))
    one, other = Listener(), Listener()
    block_holdout(known, {"one": one}, 20.0)
    block_holdout(known, {"mean": height_mean, "other": other}, 20.0)
    assert len(one.heard) == 10
    for (_, ours_m, _), (_, theirs_m, _) in zip(one.heard, other.heard, strict=True):
        assert (ours_m == theirs_m).all()


def test_the_same_seed_hides_the_same_blocks_and_another_seed_others() -> None:
    points_m = lattice(20, (30.0,))
    known = known_cells(points_m, np.random.default_rng(1).normal(0, 5, len(points_m)))
    first, second, again = (block_holdout(known, {"mean": height_mean}, 40.0, seed=seed) for seed in (1, 2, 1))
    assert first == again
    assert first["mean"].rmse_db != second["mean"].rmse_db


def test_errors_and_coverage_by_hand() -> None:
    """Two blocks of five are hidden: with four samples of noise 2 dB and an uncertainty of 1 dB, 2.77 dB are the interval."""
    values_db = np.array([1.0, 2.7, -2.7, 4.0, 0.0])
    known = known_cells([(100.0 * i, 0.0, 30.0) for i in range(5)], values_db, n_samples=4.0)
    listener = Listener(0.0, 1.0, 2.0)
    result = block_holdout(known, {"it": listener}, 60.0, hidden_share=0.4)["it"]
    hidden_db = [values_db[(targets_m[:, 0] / 100).astype(int)] for _, targets_m, _ in listener.heard]
    assert {len(values) for values in hidden_db} == {2}
    assert result.rmse_db == pytest.approx(np.mean([np.sqrt((v[0] ** 2 + v[1] ** 2) / 2) for v in hidden_db]))
    assert result.mae_db == pytest.approx(np.mean([(abs(v[0]) + abs(v[1])) / 2 for v in hidden_db]))
    assert result.coverage == pytest.approx(np.mean([[abs(x) <= 1.96 * np.sqrt(1 + 4 / 4) for x in v] for v in hidden_db]))
    assert 0 < result.coverage < 1
    assert result.answered == 1


def test_what_a_method_leaves_open_is_counted_and_does_not_count_as_an_error() -> None:
    known = known_cells([(100.0 * i, 0.0, 30.0) for i in range(10)], np.zeros(10))

    def half(known: Known, targets_m: np.ndarray, prior_db: np.ndarray) -> Estimate:
        mean_db = np.where(np.arange(len(targets_m)) == 0, np.nan, 3.0)
        return Estimate(mean_db, np.where(np.isnan(mean_db), np.nan, 9.0), 0.0)

    assert block_holdout(known, {"half": half}, 60.0)["half"] == pytest.approx((3.0, 3.0, 1.0, 0.5))


def test_the_mean_per_height_by_hand() -> None:
    known = known_cells([(0, 0, 20), (10, 0, 20), (0, 0, 30), (10, 0, 30), (20, 0, 30)], np.array([1.0, 5, 0, 3, 6]))
    result = height_mean(known, np.array([(50.0, 9.0, 30.0), (0.0, 0.0, 20.0), (0.0, 0.0, 40.0)]), np.zeros(3))
    np.testing.assert_allclose(result.mean_db, [3.0, 3.0, np.nan])
    np.testing.assert_allclose(result.std_db, [np.sqrt(6), 2.0, np.nan])


def test_inverse_distance_by_hand() -> None:
    """Two neighbours at 10 and 20 m weigh 4 to 1; the third lies beyond the radius, the fourth at another height."""
    known = known_cells([(0, 0, 30), (30, 0, 30), (90, 0, 30), (10, 0, 40)], np.array([5.0, 10.0, 99.0, 99.0]))
    result = inverse_distance(35.0)(known, np.array([(10.0, 0.0, 30.0), (500.0, 0.0, 30.0)]), np.zeros(2))
    np.testing.assert_allclose(result.mean_db, [(4 * 5.0 + 10.0) / 5, np.nan])
    # Left out, each of the first two is taken for the other.
    np.testing.assert_allclose(result.std_db, [5.0, np.nan])


def drawn_field(seed: int, noise_db: float = 1.5, n_samples: float = 3.0) -> Known:
    """Cell means at two heights, drawn from a known process and measured with noise."""
    rng = np.random.default_rng(seed)
    points_m = lattice(20, (30.0, 50.0), step_m=12.0)
    field_db = GaussianProcess(Kernel(5.0, 60.0, 40.0), points_m, 4.0).sample(rng)
    noise_db_of_mean = noise_db / np.sqrt(n_samples)
    known = known_cells(points_m, field_db + noise_db_of_mean * rng.standard_normal(len(points_m)), n_samples)
    return known._replace(squares_db2=noise_db**2 * rng.chisquare(n_samples - 1, len(points_m)))


def test_intervals_of_the_gaussian_process_hold_what_they_promise() -> None:
    methods = {"mean": height_mean, "nearest": inverse_distance(80.0), "process": gaussian_process}
    results = block_holdout(drawn_field(3), methods, 36.0, splits=4)
    assert 0.90 <= results["process"].coverage <= 0.99
    assert results["process"].answered == 1
    assert results["process"].rmse_db < 1.02 * results["nearest"].rmse_db < 0.9 * results["mean"].rmse_db


def test_a_trend_helps_as_far_as_it_is_right() -> None:
    """The process scales and shifts it by itself, and drops one that says the opposite."""
    known = drawn_field(4)
    ragged_db = 6 * np.random.default_rng(0).standard_normal(len(known.mean_db))
    ragged = known._replace(mean_db=known.mean_db + ragged_db)
    trends_db = {"none": 0 * ragged_db, "right": ragged_db / 2 - 40.0, "opposite": -ragged_db}
    rmse_db = {
        name: block_holdout(ragged._replace(prior_db=trend_db), {"it": gaussian_process}, 60.0, splits=2)["it"].rmse_db
        for name, trend_db in trends_db.items()
    }
    assert rmse_db["right"] < 0.6 * rmse_db["none"]
    assert rmse_db["opposite"] == pytest.approx(rmse_db["none"], rel=1e-6)


def test_too_few_blocks_are_refused() -> None:
    known = known_cells([(100.0 * i, 0.0, 30.0) for i in range(4)], np.zeros(4))
    with pytest.raises(InputError, match=r"4 block\(s\) of 60 m; .* at least 5: use smaller blocks"):
        block_holdout(known, {"mean": height_mean}, 60.0)


@pytest.mark.shared
def test_filling_holes_of_the_measured_logs_beats_the_mean_per_height_by_far() -> None:
    default = MeasuredMap()
    assert default.fill == "inverse-distance"
    known = measured_cells(import_logs(sorted(UKM.glob("*m.csv")), bin_m=10.0, fill_radius_m=0.0))
    methods = {"mean": height_mean, "default": inverse_distance(default.fill_radius_m)}
    results = block_holdout(known, methods)
    assert results["default"].rmse_db <= 0.6 * results["mean"].rmse_db
    assert results["default"].answered > 0.95
