"""The metrics, each one function of a `Summary`; a new entry appears in table, figure and page.

Definitions: SINR counts in the cell that is entered, the start excluded. The share below the threshold is over all
steps of all flights, failures included: read it beside the share that reached the goal.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from cellpilot.evaluate.flights import SINR_LEVELS_DB
from cellpilot.evaluate.statistics import weighted_quantile
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


@dataclass(frozen=True)
class Metric:
    """A figure of merit: what it is called in tables, and its unit or kind of number."""

    compute: Callable[[Summary], Any]
    label: str
    form: str  # percent | number | steps | list


METRICS: dict[str, Metric] = {
    "reached_share": Metric(reached_share, "goal reached", "percent"),
    "low_sinr_share": Metric(low_sinr_share, "steps below threshold", "percent"),
    "path_ratio_mean": Metric(path_ratio_mean, "path ratio mean", "number"),
    "path_ratio_p50": Metric(_path_ratio_quantile(0.5, failures=False), "p50", "number"),
    "path_ratio_p90": Metric(_path_ratio_quantile(0.9, failures=False), "p90", "number"),
    "path_ratio_p90_failures_infinite": Metric(_path_ratio_quantile(0.9, failures=True), "p90, failures infinite", "number"),
    "return_mean": Metric(return_mean, "return", "number"),
    "longest_outage_p90_steps": Metric(longest_outage_p90_steps, "longest outage p90 (steps)", "steps"),
    "longest_outage_p90_s": Metric(longest_outage_p90_s, "longest outage p90 (s)", "number"),
    "handovers_per_km": Metric(handovers_per_km, "handovers per km", "number"),
    "ping_pong_share": Metric(ping_pong_share, "ping-pong", "percent"),
    "links_lost_per_km": Metric(links_lost_per_km, "links lost per km", "number"),
    "serving_loss_mean_db": Metric(serving_loss_mean_db, "below best sector (dB)", "number"),
    "altitude_share": Metric(altitude_share, "share of steps by height", "list"),
    "rf_class_share": Metric(rf_class_share, "RF class shares", "list"),
}
