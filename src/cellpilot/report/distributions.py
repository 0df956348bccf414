"""Distributions over the sampled flights: SINR, path ratio, return (Figures 5.1 to 5.3) and height (Figure 5.18)."""

from collections.abc import Mapping

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import ArrayLike, NDArray

from cellpilot.array_types import FloatArray
from cellpilot.evaluate import METRICS
from cellpilot.report.style import COLUMN_WIDTH_IN, VERMILION, Line, legend_below, policy_line, single_axes
from cellpilot.runs.content import Content

Curve = tuple[FloatArray, FloatArray]
Limits = tuple[float, float]

NOT_DRAWN = ("optimal-undiscounted",)
"""Policies left out of the curves, where they would hide the optimum."""

TAIL = 0.005
"""Share of flights that may lie beyond an axis, so that a few odd ones do not squeeze the rest."""

LARGEST_PATH_RATIO = 5.0
"""The path-ratio axis ends here at the latest."""

REFERENCES = ("greedy", "optimal")


def drawn_policies(run: Content) -> dict[str, Line]:
    """Policies with a curve, and how it is drawn."""
    names = [name for name in run.policy_names if name not in NOT_DRAWN]
    others = [name for name in names if policy_line(name).label == name]
    return {name: policy_line(name, others) for name in names}


def empirical_cdf(values: ArrayLike, n: int | None = None) -> Curve:
    """Sorted values and the share of all `n` observations up to and including each; the rest (`n` - values) is infinite."""
    ordered = np.sort(np.asarray(values, dtype=float))
    return ordered, np.arange(1, ordered.size + 1) / (ordered.size if n is None else n)


def histogram_cdf(counts: ArrayLike, levels: ArrayLike) -> Curve:
    """Levels and the share below each, from the counts `[levels + 1]` between them (first and last bin open-ended)."""
    counts = np.asarray(counts, dtype=float)
    return np.asarray(levels, dtype=float), np.cumsum(counts)[:-1] / max(counts.sum(), 1e-300)


def path_ratio_cdf(reached: ArrayLike, n_steps: ArrayLike, shortest_steps: ArrayLike) -> Curve:
    """CDF of steps flown over shortest steps; flights that fail are infinite, so it ends at the share that reached."""
    reached = np.asarray(reached, dtype=bool)
    return empirical_cdf(np.asarray(n_steps)[reached] / np.asarray(shortest_steps)[reached], reached.size)


def sinr_cdfs(run: Content) -> dict[str, Curve]:
    """CDF of the measured SINR [dB] of each policy."""
    return {
        name: histogram_cdf(run.flights["sinr_histogram"].sel(policy=name).values, run.flights["sinr_level_db"].values)
        for name in drawn_policies(run)
    }


def path_ratio_cdfs(run: Content) -> dict[str, Curve]:
    """CDF of the path ratio of each policy."""
    names = ("reached", "n_steps", "shortest_steps")
    return {policy: path_ratio_cdf(*(_column(run, policy, name) for name in names)) for policy in drawn_policies(run)}


def return_cdfs(run: Content) -> dict[str, Curve]:
    """CDF of the return of each policy."""
    return {policy: empirical_cdf(_column(run, policy, "drawn_return")) for policy in drawn_policies(run)}


def _column(run: Content, policy: str, name: str) -> NDArray[np.generic]:
    return np.asarray(run.flights[name].sel(policy=policy).values)


def draw_sinr_cdf(run: Content) -> Figure:
    """CDF of measured SINR, the threshold dashed."""
    curves = sinr_cdfs(run)
    # The levels reach far beyond what is measured; show where any curve rises.
    rising = np.any([(share > 0.001) & (share < 0.999) for _, share in curves.values()], axis=0)
    levels_db = next(iter(curves.values()))[0]
    limits = (levels_db[rising][0] - 1, levels_db[rising][-1] + 1) if rising.any() else (levels_db[0], levels_db[-1])
    threshold_db = run.task.threshold_db
    limits = (min(limits[0], threshold_db - 1), max(limits[1], threshold_db + 1))
    figure = _draw_cdfs(run, curves, "measured SINR [dB]", "share of steps [1]", limits)
    axes = figure.axes[0]
    axes.axvline(threshold_db, color=VERMILION, linestyle=(0, (4, 2)), linewidth=1.2)
    axes.annotate(
        f"threshold {threshold_db:g} dB",
        (threshold_db, 1.0),
        (0, 2),
        xycoords=("data", "axes fraction"),
        textcoords="offset points",
        ha="center",
        va="bottom",
        fontsize=8,
    )
    return figure


def draw_path_ratio_cdf(run: Content) -> Figure:
    """CDF of the path ratio; a curve ends at the share that reached the goal."""
    curves = path_ratio_cdfs(run)
    slowest = max((float(np.quantile(ratio, 1 - TAIL)) for ratio, _ in curves.values() if ratio.size), default=2.0)
    limits = (0.95, float(np.clip(slowest, 2.0, LARGEST_PATH_RATIO)))
    return _draw_cdfs(run, curves, "path ratio: steps flown / shortest [1]", "share of flights [1]", limits)


def draw_return_cdf(run: Content) -> Figure:
    """CDF of the return."""
    curves = return_cdfs(run)
    limits = return_limits({name: values for name, (values, _) in curves.items()})
    return _draw_cdfs(run, curves, "return of a flight [reward]", "share of flights [1]", limits)


def return_limits(returns: Mapping[str, FloatArray]) -> tuple[float, float]:
    """Ends of the axis of returns: all flights but a tail, and not so far below baseline and optimum that these shrink.

    A flight that circles until the cap can cost a hundred times what a completed one earns.
    """
    lows = {name: float(np.quantile(values, TAIL)) for name, values in returns.items()}
    high = max(float(values.max()) for values in returns.values())
    reference = min((lows[name] for name in REFERENCES if name in lows), default=min(lows.values()))
    low = max(min(lows.values()), reference - (high - reference))
    margin = 0.03 * (high - low) + 1e-6
    return low - margin, high + margin


def _draw_cdfs(run: Content, curves: dict[str, Curve], x_label: str, y_label: str, limits: Limits) -> Figure:
    figure, axes = single_axes(height_in=3.3)
    axes.set(xlabel=x_label, ylabel=y_label, xlim=limits, ylim=(-0.02, 1.02))
    for name, line in drawn_policies(run).items():
        values, share = curves[name]
        if values.size:
            # From 0 below the first value, and flat beyond the last one.
            values, share = np.concatenate([values[:1], values, [np.inf]]), np.concatenate([[0.0], share, share[-1:]])
            values[-1] = max(limits[1], values[-2])
        look = {"color": line.colour, "linestyle": line.style, "label": line.label, "drawstyle": "steps-post"}
        # Where two policies fly the same way, the gaps of a dashed curve show the solid one below.
        axes.plot(values, share, zorder=2.0 if line.style == "-" else 2.1, **look)
    legend_below(figure, axes.get_lines())
    return figure


def altitude_shares(run: Content) -> dict[str, list[float]]:
    """Share of steps at each height, lowest first, of each policy."""
    rows = run.metrics["policies"]
    return {name: [float(x) for x in rows[name]["altitude_share"]] for name in drawn_policies(run) if name in rows}


def draw_altitude(run: Content) -> Figure | None:
    """Share of steps at each height, one bar per policy; None where there is one height."""
    if not run.is_3d:
        return None
    shares, lines = altitude_shares(run), drawn_policies(run)
    figure, axes = single_axes(width_in=max(COLUMN_WIDTH_IN, 0.9 * len(run.world.grid.z_m)), height_in=3.0)
    place, width = np.arange(len(run.world.grid.z_m)), 0.84 / max(len(shares), 1)
    for i, (name, share) in enumerate(shares.items()):
        line = lines[name]
        offset = (i - (len(shares) - 1) / 2) * width
        axes.bar(
            place + offset,
            share,
            0.92 * width,
            label=line.label,
            color=line.colour,
            hatch=line.hatch,
            edgecolor="white",
            linewidth=0.4,
        )
    axes.set(xlabel="height above ground [m]", ylabel=METRICS["altitude_share"].axis, xticks=place, ylim=(0, None))
    axes.set_xticklabels([f"{z:g}" for z in run.world.grid.z_m])
    axes.legend(loc="best")
    return figure
