"""Learning curves: of this run, of the ablation (Figure 5.19), and the sensitivity to the rewards."""

import numpy as np
import xarray as xr
from matplotlib.figure import Figure
from matplotlib.ticker import NullFormatter
from numpy.typing import ArrayLike, NDArray

from cellpilot.array_types import FloatArray
from cellpilot.evaluate import METRICS
from cellpilot.report.style import BLUE, GREEN, GREY, PAGE_WIDTH_IN, PURPLE, VERMILION, Line, policy_line, single_axes
from cellpilot.runs.content import Content

POINTS = 400
"""A curve has about this many points; more cannot be told apart on paper."""

VARIANT_LINES = {
    "DQN": Line("DQN", GREY, ":"),
    "DDQN": Line("DDQN", GREEN, (0, (5, 1.5, 1, 1.5))),
    "DQN+HER": Line("DQN + HER", BLUE, "--"),
    "DDQN+HER": Line("DDQN + HER", VERMILION, "-"),
}

EXPLORATION_LABELS = {"boltzmann": "temperature\n[reward]", "epsilon-greedy": "epsilon\n[1]"}


def smoothing_window(n_rounds: int) -> int:
    """Episodes, or rounds, that one point of a curve averages: a hundredth of all, more of a short training."""
    return max(1, min(n_rounds // 10, 20), n_rounds // 100)


def windows(values: ArrayLike, window: int) -> tuple[FloatArray, FloatArray]:
    """Episode at the centre of each window (counted from 1), and the windows `[..., points, window]` over the last axis."""
    values = np.asarray(values, dtype=float)
    window = min(window, values.shape[-1])
    view = np.lib.stride_tricks.sliding_window_view(values, window, axis=-1)
    stride = max(1, view.shape[-2] // POINTS)
    first = np.arange(0, view.shape[-2], stride)
    return first + (window + 1) / 2, view[..., first, :]


def moving_mean(values: ArrayLike, window: int) -> tuple[FloatArray, FloatArray]:
    """Episodes and the mean of `window` episodes around each, over the last axis; only whole windows count."""
    episode, view = windows(values, window)
    return episode, view.mean(-1)


def without_gaps(values: ArrayLike, n_steps: ArrayLike) -> FloatArray:
    """Values `[rounds]`; a round in which no flight ended (0 steps) has that of the last before it, else of the first after."""
    ended = np.flatnonzero(np.asarray(n_steps) > 0)
    values = np.asarray(values, dtype=float)
    if not ended.size:
        return values
    last = np.searchsorted(ended, np.arange(values.size), side="right") - 1
    return values[ended[last.clip(0)]]


def draw_training(run: Content) -> Figure | None:
    """Return, share that reached and exploration of each training episode, or round; None without training."""
    if run.training is None:
        return None
    data = run.training
    counts = str(data.attrs.get("counts", "episodes"))
    returns, reached = (without_gaps(data[name].values, data["n_steps"].values) for name in ("episode_return", "reached"))
    window = smoothing_window(data.sizes["episode"])
    figure = Figure(figsize=(PAGE_WIDTH_IN, 5.2), layout="constrained")
    top, middle, bottom = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.2, 1))
    episode, view = windows(returns, window)
    mean = view.mean(-1)
    low, high = np.quantile(view, [0.1, 0.9], axis=-1)
    top.fill_between(episode, low, high, color=BLUE, alpha=0.2, linewidth=0, label="10th to 90th percentile")
    top.plot(episode, mean, color=BLUE, label=f"mean of {window} {counts}")
    # The first flights of an untrained agent are far below everything that follows.
    floor, ceiling = np.quantile(low, 0.02), high.max()
    top.set_ylim(floor - 0.05 * (ceiling - floor) - 0.1, ceiling + 0.05 * (ceiling - floor) + 0.1)
    top.legend(loc="lower right")
    top.set_ylabel("return [reward]")
    middle.plot(*moving_mean(reached, window), color=GREEN)
    middle.set(ylabel="goal reached\n[share]", ylim=(-0.03, 1.03))
    bottom.plot(*moving_mean(data["exploration"].values, 1), color=PURPLE)
    kind = str(data.attrs.get("exploration", ""))
    bottom.set(
        xlabel=f"training {counts} [1]",
        ylabel=EXPLORATION_LABELS.get(kind, "exploration\n[1]"),
        ylim=(0, None),
    )
    bottom.set_xlim(0, data.sizes["episode"])
    for axes in (top, middle, bottom):
        axes.grid(True)
    figure.align_ylabels()
    return figure


def ablation_curves(data: xr.Dataset, window: int) -> dict[str, tuple[FloatArray, FloatArray, FloatArray]]:
    """Episodes, mean and standard deviation over the seeds of the smoothed return of each variant."""
    curves = {}
    for variant in data["variant"].values:
        returns = data["episode_return"].sel(variant=variant).transpose("seed", "episode").values
        episode, smooth = moving_mean(returns, window)
        spread = smooth.std(0, ddof=1) if len(smooth) > 1 else np.zeros(smooth.shape[1])
        curves[str(variant)] = (episode, smooth.mean(0), spread)
    return curves


def draw_ablation(data: xr.Dataset) -> Figure:
    """Mean return of each variant with one standard deviation over the seeds."""
    window = smoothing_window(data.sizes["episode"])
    figure, axes = single_axes(width_in=PAGE_WIDTH_IN, height_in=3.6)
    fallback = Line("", PURPLE, (0, (3, 1, 1, 1)))
    for variant, (episode, mean, spread) in ablation_curves(data, window).items():
        line = VARIANT_LINES.get(variant, fallback._replace(label=variant))
        axes.fill_between(episode, mean - spread, mean + spread, color=line.colour, alpha=0.15, linewidth=0)
        axes.plot(episode, mean, color=line.colour, linestyle=line.style, label=line.label)
    seeds = data.sizes["seed"]
    axes.set(xlabel="training episode [1]", ylabel="return [reward]", xlim=(0, data.sizes["episode"]))
    axes.set_title(f"mean ± standard deviation over {seeds} seeds, mean of {window} episodes")
    axes.legend(loc="lower right")
    return figure


KNOB_LABELS = {"rho_sinr/rho_step": "reward ratio rho_sinr / rho_step [1]", "rho_goal": "reward for the goal rho_goal [reward]"}
KNOB_DEFAULTS = {"rho_sinr/rho_step": "default_ratio", "rho_goal": "default_rho_goal"}
LOG_FROM = 20.0
"""An axis is logarithmic where its largest value is at least so many times its smallest."""


def sensitivity_curves(data: xr.Dataset, knob: str) -> dict[str, xr.Dataset]:
    """Points of one knob for each policy, in the order of its value."""
    here = data.isel(point=np.flatnonzero(data["knob"].values.astype(str) == knob))
    names = here["policy"].values.astype(str)
    return {str(name): here.isel(point=np.flatnonzero(names == name)).sortby("value") for name in dict.fromkeys(names)}


def draw_sensitivity(data: xr.Dataset) -> Figure:
    """Share below the threshold, path ratio and share reached against the rewards."""
    knobs = list(dict.fromkeys(data["knob"].values.astype(str)))
    figure = Figure(figsize=(PAGE_WIDTH_IN if len(knobs) > 1 else 4.1, 6.0), layout="constrained")
    panels = figure.subplots(3, len(knobs), sharex="col", sharey="row", squeeze=False)
    quantities = {
        "low_sinr_share": f"{METRICS['low_sinr_share'].axis}\nof {data.attrs['threshold_db']:g} dB",
        "path_ratio_p90": "path ratio [1]\nmean and p90",
        "reached_share": METRICS["reached_share"].axis,
    }
    for column, knob in enumerate(knobs):
        curves = sensitivity_curves(data, knob)
        others = [name for name in curves if policy_line(name).label == name]
        for name, points in curves.items():
            line = policy_line(name, others)
            look = {"color": line.colour, "linestyle": line.style, "markersize": 4}
            value = points["value"].values
            for row, quantity in enumerate(quantities):
                panels[row, column].plot(value, points[quantity].values, marker="o", label=line.label, **look)
            panels[1, column].plot(value, points["path_ratio_mean"].values, marker="s", markerfacecolor="white", **look)
        _finish_column(panels[:, column], data, knob)
    for row, label in enumerate(quantities.values()):
        panels[row, 0].set_ylabel(label)
    panels[1, 0].plot([], [], color="black", marker="o", markersize=4, label="p90")
    panels[1, 0].plot([], [], color="black", marker="s", markersize=4, markerfacecolor="white", label="mean")
    panels[0, 0].legend(loc="best")
    panels[1, 0].legend(handles=panels[1, 0].get_lines()[-2:], loc="best")
    figure.align_ylabels()
    return figure


def _finish_column(panels: NDArray[np.object_], data: xr.Dataset, knob: str) -> None:
    values = data["value"].values[data["knob"].values.astype(str) == knob]
    default = data.attrs.get(KNOB_DEFAULTS.get(knob, ""))
    for axes in panels:
        axes.grid(True)
        if values.min() > 0 and values.max() >= LOG_FROM * values.min():
            axes.set_xscale("log")
            axes.xaxis.set_major_formatter("{x:g}")
            axes.xaxis.set_minor_formatter(NullFormatter())
        if default is not None:
            axes.axvline(float(default), color="0.4", linestyle=(0, (4, 2)), linewidth=1.0)
    if default is not None:
        panels[0].set_title(f"dashed: default {float(default):g}")
    panels[-1].set_xlabel(KNOB_LABELS.get(knob, f"{knob} [1]"))
