import numpy as np
import pytest

from cellpilot.evaluate import METRICS
from cellpilot.evaluate.evaluation import add_compared
from cellpilot.evaluate.flights import SINR_LEVELS_DB
from cellpilot.evaluate.statistics import half_interval, mean_interval, ratio_interval, share_interval, t95, weighted_quantile
from cellpilot.evaluate.summary import Summary


def summary(**changes: object) -> Summary:
    """Ten flights: five on the shortest path, three 1.5 and one 2 times as long, one failure."""
    arrivals = np.zeros((21, 7))
    arrivals[4, 4], arrivals[6, 6] = 3, 2
    arrivals[6, 4], arrivals[9, 6] = 1, 2
    arrivals[8, 4] = 1
    values = {
        "n_flights": 10.0,
        "arrivals": arrivals,
        "n_steps": 80.0,
        "low_steps": 20.0,
        "return_sum": 55.0,
        "steps_by_height": np.array([60.0, 20.0, 0.0]),
        "sinr_histogram": np.zeros(len(SINR_LEVELS_DB) + 1),
        "outages": np.array([5.0, 3.0, 0.0, 1.0, 1.0]),
    }
    return Summary(**(values | changes))


def metric(name: str, of: Summary) -> object:
    return METRICS[name].compute(of)


def test_metrics_by_hand() -> None:
    s = summary()
    assert metric("reached_share", s) == pytest.approx(0.9)
    assert metric("low_sinr_share", s) == pytest.approx(0.25)
    assert metric("return_mean", s) == pytest.approx(5.5)
    assert metric("path_ratio_mean", s) == pytest.approx((5 * 1.0 + 3 * 1.5 + 2.0) / 9)
    assert metric("path_ratio_p50", s) == 1.0
    assert metric("path_ratio_p90", s) == 2.0  # nine tenths of nine flights are 8.1: the ninth
    assert metric("path_ratio_p90_failures_infinite", s) == 2.0  # the ninth of ten
    assert metric("altitude_share", s) == [0.75, 0.25, 0.0]
    assert metric("longest_outage_p90_steps", s) == 3.0


def test_failures_count_as_infinite_ratios() -> None:
    s = summary(n_flights=12.0)
    assert metric("path_ratio_p90", s) == 2.0
    assert metric("path_ratio_p90_failures_infinite", s) == np.inf
    none = summary(arrivals=np.zeros((21, 7)))
    assert metric("path_ratio_p50", none) is None
    assert metric("path_ratio_p90_failures_infinite", none) == np.inf
    assert metric("reached_share", none) == 0.0


def test_rounding_is_no_failure() -> None:
    s = summary()
    s.arrivals[:] *= (1 - 1e-14) / 0.9
    assert metric("path_ratio_p90_failures_infinite", s) == metric("path_ratio_p90", s) == 2.0


def histogram_of(measured: list[float]) -> np.ndarray:
    return np.bincount(np.searchsorted(SINR_LEVELS_DB, measured, side="right"), minlength=len(SINR_LEVELS_DB) + 1).astype(float)


def test_radio_classes_by_hand() -> None:
    """Excellent from 20 dB, good from 13, mid cell from 0, cell edge below; lower bounds included."""
    measured = [-99.0, -0.01, 0.0, 5.0, 12.99, 13.0, 19.9, 20.0, 25.0, 99.0]
    shares = metric("rf_class_share", summary(sinr_histogram=histogram_of(measured)))
    assert shares == pytest.approx({"excellent": 0.3, "good": 0.2, "mid cell": 0.3, "cell edge": 0.2})


def test_two_sets_of_flights_add_up() -> None:
    both = summary() + summary(n_flights=30.0, low_steps=40.0)
    assert both.n_flights == 40.0
    assert both.arrivals.sum() == 18.0
    assert metric("low_sinr_share", both) == pytest.approx(60 / 160)
    assert metric("reached_share", both) == pytest.approx(18 / 40)


@pytest.mark.parametrize(
    ("values", "weights", "q", "expected"),
    [
        ([1.0, 2.0, 3.0], [1.0, 1.0, 1.0], 0.5, 2.0),
        ([3.0, 1.0, 2.0], [1.0, 1.0, 1.0], 0.34, 2.0),
        ([3.0, 1.0, 2.0], [0.1, 0.8, 0.1], 0.8, 1.0),
        ([3.0, 1.0, 2.0], [0.1, 0.8, 0.1], 0.81, 2.0),
        ([1.0, np.inf], [9.0, 1.0], 0.9, 1.0),
        ([1.0, np.inf], [8.9, 1.1], 0.9, np.inf),
        ([1.0, 5.0], [1.0, 0.0], 1.0, 1.0),
        ([1.0, 5.0], [0.0, 0.0], 0.5, None),
    ],
)
def test_weighted_quantile_by_hand(values: list[float], weights: list[float], q: float, expected: float | None) -> None:
    assert weighted_quantile(np.array(values), np.array(weights), q) == expected


def test_intervals_by_hand() -> None:
    assert share_interval(8, 10) == pytest.approx((0.4901625, 0.9433178), abs=1e-6)
    assert share_interval(10, 10) == pytest.approx((0.7224672, 1.0), abs=1e-6)
    assert share_interval(0, 10) == pytest.approx((0.0, 0.2775328), abs=1e-6)
    assert mean_interval(np.array([1.0, 2.0, 3.0])) == pytest.approx((2 - 4.302653 / np.sqrt(3), 2 + 4.302653 / np.sqrt(3)))
    low, high = mean_interval(np.array([0.0, 1.0]))  # two seeds: 12.7 standard errors, not 1.96
    assert (low, high) == pytest.approx((0.5 - 6.353102, 0.5 + 6.353102))
    assert mean_interval(np.array([4.0])) is None
    assert ratio_interval(np.array([1.0]), np.array([2.0])) is None
    assert t95(100_000) == pytest.approx(1.959988, abs=1e-5)
    assert np.isnan(half_interval(np.ones((3, 1)))).all()
    many = np.random.default_rng(0).normal(size=(4000, 3))
    assert (np.abs(many.mean(-1)) <= half_interval(many)).mean() == pytest.approx(0.95, abs=0.01)
    # ratio 12/24; residuals (1 - 2, 4 - 4, 7 - 6)/8 have the standard deviation 1/8
    low, high = ratio_interval(np.array([1.0, 4.0, 7.0]), np.array([4.0, 8.0, 12.0]))
    assert (low, high) == pytest.approx((0.5 - 4.302653 / 8 / np.sqrt(3), 0.5 + 4.302653 / 8 / np.sqrt(3)))


def test_intervals_cover_the_truth_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    n, runs, inside = 300, 1_000, np.zeros(3)
    for _ in range(runs):
        steps = rng.integers(1, 20, n).astype(float)
        low = rng.binomial(steps.astype(int), 0.1 + 0.02 * steps).astype(float)  # long flights see more low cells
        intervals = (
            (ratio_interval(low, steps), (0.1 * 10 + 0.02 * np.mean(np.arange(1, 20) ** 2)) / 10),
            (share_interval(rng.binomial(n, 0.97), n), 0.97),
            (mean_interval(steps), 10.0),
        )
        inside += [a <= truth <= b for (a, b), truth in intervals]
    assert (np.abs(inside / runs - 0.95) < 0.03).all()


def test_score_by_hand() -> None:
    table: dict[str, dict[str, object]] = {
        name: {"return_mean": value} for name, value in (("greedy", 2.0), ("optimal", 6.0), ("x", 7.0))
    }
    add_compared(table)
    assert [row["score"] for row in table.values()] == [0.0, 1.0, 1.25]
    assert [row["regret_mean"] for row in table.values()] == [4.0, 0.0, -1.0]
    close = {"greedy": {"return_mean": 2.0}, "optimal": {"return_mean": 2.0 + 1e-7}, "x": {"return_mean": 1.0}}
    add_compared(close)
    assert [row["score"] for row in close.values()] == [None] * 3
    assert close["x"]["regret_mean"] == pytest.approx(1.0)
