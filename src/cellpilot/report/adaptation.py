"""The picture of an adaptation: score against flights, one curve for each way to go about it."""

import json

import xarray as xr
from matplotlib.figure import Figure

from cellpilot.evaluate.statistics import mean_interval
from cellpilot.report.style import BLUE, GREEN, GREY, ORANGE, PAGE_WIDTH_IN, PURPLE, VERMILION, Line, legend_below, single_axes

LINES = (
    Line("", VERMILION, "-"),
    Line("", BLUE, "--"),
    Line("", GREEN, (0, (5, 1.5, 1, 1.5))),
    Line("", PURPLE, (0, (1, 1))),
    Line("", ORANGE, (0, (3, 1, 1, 1, 1, 1))),
)
LOWEST_SCORE = -0.5
"""The axis of scores reaches no lower: a policy that hardly arrives would hide all others."""


def draw_adapt(data: xr.Dataset) -> Figure:
    """Mean score over seeds with its 95 % interval, after each number of flights; the axis is linear up to one flight."""
    figure, axes = single_axes(width_in=PAGE_WIDTH_IN, height_in=3.6)
    flights = data["flights"].values
    lowest, labels = 0.0, json.loads(data.attrs.get("labels", "{}"))
    for i, arm in enumerate(data["arm"].values):
        scores = data["score"].sel(arm=arm).transpose("seed", "flights").values
        low, high = zip(*(mean_interval(column) for column in scores.T), strict=True)
        line = LINES[i % len(LINES)]
        axes.fill_between(flights, low, high, color=line.colour, alpha=0.18, linewidth=0)
        look = {"color": line.colour, "linestyle": line.style, "marker": "o", "markersize": 3}
        axes.plot(flights, scores.mean(0), label=labels.get(str(arm), str(arm)), **look)
        lowest = min(lowest, *low)
    for level, name in ((0.0, "greedy baseline"), (1.0, "exact optimum")):
        axes.axhline(level, color=GREY, linestyle=":", linewidth=1.0)
        axes.annotate(name, (flights[-1], level), xytext=(0, 2), textcoords="offset points", ha="right", fontsize=8, color=GREY)
    axes.set_xscale("symlog", linthresh=1)
    axes.xaxis.set_major_formatter("{x:g}")
    axes.set(xlabel="flights on the unknown network [1]", ylabel="score [1]", xlim=(0, flights[-1]))
    axes.set_ylim(max(LOWEST_SCORE, lowest - 0.05), 1.08)
    axes.set_title(f"{data.attrs.get('title', '')} · mean and 95 % interval over {data.sizes['seed']} seeds".removeprefix(" · "))
    legend_below(figure, axes.get_legend_handles_labels()[0])
    return figure
