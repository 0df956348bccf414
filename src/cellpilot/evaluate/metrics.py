"""The metrics, each one function and one entry of a table: JSON, tables, figures and page take names and units from there.

Definitions: SINR counts in the cell that is entered, the start excluded. The share below the threshold is over all
steps of all flights, failures included: read it beside the share that reached the goal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Generic, Literal, NamedTuple, TypeVar

import numpy as np

from cellpilot.evaluate.flights import SINR_LEVELS_DB, FlightRecords
from cellpilot.evaluate.statistics import mean_interval, ratio_interval, share_interval, weighted_quantile
from cellpilot.evaluate.summary import Summary

RF_CLASSES_DB = {"excellent": (20.0, np.inf), "good": (13.0, 20.0), "mid cell": (0.0, 13.0), "cell edge": (-np.inf, 0.0)}
"""SINR classes of Figure 4.4 [dB]: lower bound included."""

FLAT = 1e-6
"""Below this difference of return between optimum and baseline there is nothing to score."""


def reached_share(summary: Summary) -> float:
    """Share of flights that reached the goal within the cap on steps."""
    return float(summary.arrivals.sum() / summary.n_flights)


def low_sinr_share(summary: Summary) -> float:
    """Share of all steps below the threshold."""
    return summary.low_steps / summary.n_steps


def _ratios(summary: Summary, failures: bool) -> tuple[np.ndarray, np.ndarray]:
    steps, shortest = np.nonzero(summary.arrivals)
    ratio, mass = steps / shortest, summary.arrivals[steps, shortest]
    if failures:
        ratio, mass = np.append(ratio, np.inf), np.append(mass, summary.n_flights - summary.arrivals.sum())
        mass[-1] = mass[-1] if mass[-1] > 1e-9 * summary.n_flights else 0.0
    return ratio, mass


def path_ratio_mean(summary: Summary) -> float | None:
    """Mean of steps flown over steps of the shortest allowed path, over flights that reached the goal."""
    ratio, mass = _ratios(summary, failures=False)
    return float(ratio @ mass / mass.sum()) if mass.sum() else None


def _path_ratio_quantile(q: float, failures: bool) -> Callable[[Summary], float | None]:
    def quantile(summary: Summary) -> float | None:
        return weighted_quantile(*_ratios(summary, failures), q)

    return quantile


def return_mean(summary: Summary) -> float:
    """Mean undiscounted return per flight, the cap included."""
    return summary.return_sum / summary.n_flights


def score(found: Summary, greedy: Summary, optimal: Summary) -> float | None:
    """(policy - greedy) / (optimal - greedy) of the mean returns; see `share_of_gain`."""
    return share_of_gain(return_mean(found), return_mean(greedy), return_mean(optimal))


def share_of_gain(found: float, greedy: float, optimal: float) -> float | None:
    """(found - greedy) / (optimal - greedy) of mean returns, not clipped; None where those two are the same."""
    gain = optimal - greedy
    return (found - greedy) / gain if abs(gain) >= FLAT else None


class Returns(NamedTuple):
    """Mean returns of a policy, the baseline and the optimum; None for one that was not flown."""

    found: float
    greedy: float | None
    optimal: float | None


def _regret(returns: Returns) -> float | None:
    return None if returns.optimal is None else returns.optimal - returns.found


def _score(returns: Returns) -> float | None:
    if returns.greedy is None or returns.optimal is None:
        return None
    return share_of_gain(returns.found, returns.greedy, returns.optimal)


def altitude_share(summary: Summary) -> list[float]:
    """Share of steps at each height, lowest first (Figure 5.18)."""
    return [float(x) for x in summary.steps_by_height / summary.n_steps]


def longest_outage_p90_steps(summary: Summary) -> float | None:
    """90th percentile over flights of the longest run of steps below the threshold."""
    return weighted_quantile(np.arange(summary.outages.size, dtype=float), summary.outages, 0.9)


def rf_class_share(summary: Summary) -> dict[str, float]:
    """Share of measurements in each class of Figure 4.4."""
    cumulative = np.concatenate([[0.0], np.cumsum(summary.sinr_histogram)]) / summary.sinr_histogram.sum()

    def below(level_db: float) -> float:
        if not np.isfinite(level_db):
            return float(level_db > 0)
        return float(cumulative[np.searchsorted(SINR_LEVELS_DB, level_db - 1e-6) + 1])

    return {name: below(high) - below(low) for name, (low, high) in RF_CLASSES_DB.items()}


def longest_outage_p90_s(summary: Summary) -> float | None:
    """90th percentile over drawn flights of the longest time below the threshold [s], at the planned speed."""
    return summary.mobility.longest_outage_p90_s


def handovers_per_km(summary: Summary) -> float | None:
    """Handovers after the A3 rule per kilometre flown; None where the map does not know every sector."""
    mobility = summary.mobility
    return 1000.0 * mobility.handovers / mobility.followed_m if mobility.followed_m else None


def ping_pong_share(summary: Summary) -> float | None:
    """Share of handovers that lead back to the sector left less than a second before; None without handovers."""
    mobility = summary.mobility
    return mobility.ping_pongs / mobility.handovers if mobility.handovers else None


def serving_loss_mean_db(summary: Summary) -> float | None:
    """Mean over steps of the best sector's SINR minus the serving sector's [dB], in the cell that is entered."""
    mobility = summary.mobility
    return mobility.lost_db / mobility.linked_steps if mobility.linked_steps else None


def links_lost_per_km(summary: Summary) -> float | None:
    """Cells entered per kilometre in which nothing is heard of the serving sector; None where the map does not know them."""
    mobility = summary.mobility
    return 1000.0 * mobility.links_lost / mobility.followed_m if mobility.followed_m else None


def _reached_interval(records: FlightRecords) -> tuple[float, float]:
    return share_interval(records.reached.sum(), len(records.reached))


def _low_sinr_interval(records: FlightRecords) -> tuple[float, float] | None:
    return ratio_interval(records.low_steps.astype(float), records.n_steps.astype(float))


def _path_ratio_interval(records: FlightRecords) -> tuple[float, float] | None:
    return mean_interval(records.n_steps[records.reached] / records.shortest_steps[records.reached])


def _return_interval(records: FlightRecords) -> tuple[float, float] | None:
    return mean_interval(records.drawn_return)


class Interval(NamedTuple):
    """The 95 % interval of a metric: its name in the JSON, and how it follows from sampled flights."""

    name: str
    compute: Callable[[FlightRecords], tuple[float, float] | None]


Of = TypeVar("Of")
MetricForm = Literal["percent", "number", "score", "steps", "list"]


@dataclass(frozen=True)
class Metric(Generic[Of]):
    """A figure of merit: how it is computed, and how it is named and written wherever it appears."""

    compute: Callable[[Of], Any]
    label: str
    unit: str
    """Of the number in the JSON; "1" for a share or a ratio."""
    long_name: str
    form: MetricForm
    """How people read it: a share is written in percent; a list has no column in the tables."""
    terminal: Literal["", "routes", "network"] = ""
    """Which table of `evaluate` in the terminal has a column of it."""
    short: str = ""
    """Heading there, where the label is too long."""
    interval: Interval | None = None

    @property
    def heading(self) -> str:
        """Label and unit above a column of written numbers, which have their percent signs with them."""
        return self.label if self.unit == "1" else f"{self.label} [{self.unit}]"

    @property
    def axis(self) -> str:
        """Label and unit along an axis."""
        return f"{self.label} [{self.unit}]"


METRICS: dict[str, Metric[Summary]] = {
    "reached_share": Metric(
        reached_share,
        "goal reached",
        "1",
        "Share of flights that reach the goal within the cap on steps.",
        "percent",
        "routes",
        "reached",
        Interval("reached_ci95", _reached_interval),
    ),
    "low_sinr_share": Metric(
        low_sinr_share,
        "steps below threshold",
        "1",
        "Share of all steps, over all flights and failed ones included, with SINR below the threshold in the cell entered. "
        "Read it beside the share that reached: circling in good cells lowers it.",
        "percent",
        "routes",
        "below",
        Interval("low_sinr_ci95", _low_sinr_interval),
    ),
    "path_ratio_mean": Metric(
        path_ratio_mean,
        "path ratio mean",
        "1",
        "Steps flown over the steps of a shortest allowed path, mean over flights that reach the goal.",
        "number",
        interval=Interval("path_ratio_mean_ci95", _path_ratio_interval),
    ),
    "path_ratio_p50": Metric(
        _path_ratio_quantile(0.5, failures=False),
        "path ratio p50",
        "1",
        "Half of the flights that reach the goal have at most this path ratio.",
        "number",
        "routes",
        "p50",
    ),
    "path_ratio_p90": Metric(
        _path_ratio_quantile(0.9, failures=False),
        "path ratio p90",
        "1",
        "Nine tenths of the flights that reach the goal have at most this path ratio.",
        "number",
        "routes",
        "p90",
    ),
    "path_ratio_p90_failures_infinite": Metric(
        _path_ratio_quantile(0.9, failures=True),
        "path ratio p90, failures infinite",
        "1",
        "Nine tenths of all flights have at most this path ratio; a flight that fails counts as infinitely long.",
        "number",
    ),
    "return_mean": Metric(
        return_mean,
        "return",
        "reward",
        "Mean sum of all rewards of a flight, without discount, up to the cap on steps.",
        "number",
        "routes",
        interval=Interval("return_ci95", _return_interval),
    ),
    "longest_outage_p90_steps": Metric(
        longest_outage_p90_steps,
        "longest outage p90",
        "steps",
        "In nine tenths of the flights, the longest run of steps below the threshold has at most this length.",
        "steps",
    ),
    "longest_outage_p90_s": Metric(
        longest_outage_p90_s,
        "longest outage p90",
        "s",
        "In nine tenths of the sampled flights, the longest time below the threshold is at most this long at the planned speed.",
        "number",
        "network",
        "outage p90 [s]",
    ),
    "handovers_per_km": Metric(
        handovers_per_km,
        "handovers",
        "1/km",
        "Handovers per kilometre of the sampled flights, after event A3: a neighbor has been stronger than the serving sector "
        "by the hysteresis for the time-to-trigger. Needs the received power of every sector in the map.",
        "number",
        "network",
        "handovers/km",
    ),
    "ping_pong_share": Metric(
        ping_pong_share,
        "ping-pong",
        "1",
        "Share of handovers back to the sector left less than a second before.",
        "percent",
        "network",
    ),
    "links_lost_per_km": Metric(
        links_lost_per_km,
        "links lost",
        "1/km",
        "Cells entered per kilometre in which the serving sector cannot be received, as behind a corner of a ray-traced city; "
        "the drone connects to the strongest sector.",
        "number",
        "network",
        "lost/km",
    ),
    "serving_loss_mean_db": Metric(
        serving_loss_mean_db,
        "below best sector",
        "dB",
        "SINR of the best sector minus SINR of the serving one, mean over the cells entered by the sampled flights: what the "
        "delay of handovers costs.",
        "number",
        "network",
        "below best [dB]",
    ),
    "altitude_share": Metric(altitude_share, "share of steps", "1", "Share of steps at each height, lowest first.", "list"),
    "rf_class_share": Metric(
        rf_class_share,
        "share of measurements",
        "1",
        "Share of measurements in each class of radio conditions (thesis, Figure 4.4).",
        "list",
    ),
}
"""Metrics of one policy, by their name in the JSON, in the order of the tables."""

COMPARED: dict[str, Metric[Returns]] = {
    "regret_mean": Metric(
        _regret,
        "regret",
        "reward",
        "Return of the exact optimum minus return of the policy, mean per flight.",
        "number",
        "routes",
    ),
    "score": Metric(
        _score,
        "score",
        "1",
        "(return − return of the baseline) / (return of the optimum − return of the baseline): 0 is the baseline, 1 the optimum; "
        "not clipped, so it is negative for a policy worse than the baseline.",
        "score",
        "routes",
    ),
}
"""Metrics that need baseline and optimum beside the policy."""


def all_metrics() -> dict[str, Metric[Any]]:
    """Every entry of both tables, by name."""
    return METRICS | COMPARED


def number_metrics() -> dict[str, Metric[Any]]:
    """Those which are one number: the columns of a table."""
    return {name: metric for name, metric in all_metrics().items() if metric.form != "list"}
