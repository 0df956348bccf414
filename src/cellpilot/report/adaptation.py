"""The picture of an adaptation: score against flights, one curve for each way to go about it."""

import json

import numpy as np
import xarray as xr
from matplotlib.figure import Figure

from cellpilot.evaluate.statistics import half_interval
from cellpilot.report.style import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PAGE_WIDTH_IN,
    PURPLE,
    VERMILION,
    Line,
    as_drawn,
    legend_below,
    single_axes,
)

LINES = (
    Line("", VERMILION, "-"),
    Line("", BLUE, "--"),
    Line("", GREEN, (0, (5, 1.5, 1, 1.5))),
    Line("", PURPLE, (0, (1, 1))),
    Line("", ORANGE, (0, (3, 1, 1, 1, 1, 1))),
)
FLIGHT_TICKS = (0, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1_000, 2_000, 5_000, 10_000)
BEND = 0.1
"""Below 0 the axis of scores goes over to a logarithmic one, as fast as this: an arm that hardly arrives hides no other."""
TICKS = (-1000.0, -100.0, -10.0, -1.0, -0.3, 0.0, 0.2, 0.4, 0.6, 0.8, 1.0)


def draw_adapt(data: xr.Dataset) -> Figure:
    """Mean score over seeds with its 95 % interval, after each number of flights.

    Flights are linear up to one and logarithmic from there on, scores linear above 0 and logarithmic below.
    """
    figure, axes = single_axes(width_in=PAGE_WIDTH_IN, height_in=3.8)
    flights = data["flights"].values
    lowest, labels = 0.0, json.loads(data.attrs.get("labels", "{}"))
    for i, arm in enumerate(data["arm"].values):
        scores = data["score"].sel(arm=arm).transpose("seed", "flights").values
        # One seed has no interval: its line stands alone.
        half = np.nan_to_num(half_interval(scores, axis=0))
        low, high = scores.mean(0) - half, scores.mean(0) + half
        line = LINES[i % len(LINES)]
        axes.fill_between(flights, low, high, color=line.colour, alpha=0.25, linewidth=0)
        look = {"color": line.colour, "linestyle": line.style, "marker": "o", "markersize": 3}
        axes.plot(flights, scores.mean(0), label=as_drawn(labels.get(str(arm), str(arm))), **look)
        lowest = min(lowest, float(low.min()))
    for level, name in ((0.0, "greedy\nbaseline"), (1.0, "exact\noptimum")):
        axes.axhline(level, color=GREY, linestyle=":", linewidth=1.0)
        axes.text(1.01, level, name, transform=axes.get_yaxis_transform(), va="center", fontsize=8, color=GREY)
    axes.set_xscale("symlog", linthresh=1, linscale=0.5)
    axes.set_xticks([*(n for n in FLIGHT_TICKS if n < flights[-1]), flights[-1]])
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set_yscale("function", functions=(_squeezed, _stretched))
    first = max((i for i, tick in enumerate(TICKS) if tick <= lowest), default=0)
    axes.set_yticks(TICKS[first:])
    axes.yaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="flights on the unknown network [1]", ylabel="score [1]", xlim=(-0.04, 1.06 * flights[-1]))
    axes.set_ylim(min(1.3 * lowest - 0.05, TICKS[first]), 1.1)
    if lowest < 0:
        axes.set_ylabel("score [1], logarithmic below 0")
    n_seeds = data.sizes["seed"]
    what = "one seed" if n_seeds == 1 else f"mean and 95 % interval over {n_seeds} seeds"
    axes.set_title(f"{as_drawn(str(data.attrs.get('title', '')))} · {what}".removeprefix(" · "))
    legend_below(figure, axes.get_legend_handles_labels()[0])
    return figure


def _squeezed(score: np.ndarray) -> np.ndarray:
    """Height of a score on paper: itself above 0, below it a logarithm that begins with the same slope."""
    return np.where(score < 0, -BEND * np.log1p(np.maximum(-score, 0) / BEND), score)


def _stretched(height: np.ndarray) -> np.ndarray:
    return np.where(height < 0, -BEND * np.expm1(np.maximum(-height, 0) / BEND), height)
