"""Drawing on one height of a grid: coloured cells, outlined and hatched areas, sites. Everything in metres."""

from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.grid import Grid
from cellpilot.report.style import PAGE_WIDTH_IN

BoolArray = NDArray[np.bool_]

MAX_PANELS = 6
COLUMNS = 3
GAP_IN = 0.06
"""Between panels and what stands above and below them [in]."""


def cell_edges_m(centres_m: tuple[float, ...], other_m: tuple[float, ...]) -> FloatArray:
    """Edges `[n + 1]` of evenly spaced cells [m]; a single cell is as wide as those of the other axis, else 1 m."""
    steps_m = np.diff(centres_m if len(centres_m) > 1 else other_m)
    half_m = steps_m[0] / 2 if steps_m.size else 0.5
    return np.append(np.asarray(centres_m) - half_m, centres_m[-1] + half_m)


def plane_edges_m(grid: Grid) -> tuple[FloatArray, FloatArray]:
    """Edges of the columns and of the rows [m]."""
    return cell_edges_m(grid.x_m, grid.y_m), cell_edges_m(grid.y_m, grid.x_m)


def chosen_heights(n_heights: int, at_most: int = MAX_PANELS) -> list[int]:
    """Indices of the heights to show: all, or `at_most` spread evenly from the lowest to the highest."""
    if n_heights <= at_most:
        return list(range(n_heights))
    return [int(i) for i in np.linspace(0, n_heights - 1, at_most).round()]


def plane_panels(
    grid: Grid, n_panels: int, columns: int = COLUMNS, width_in: float = PAGE_WIDTH_IN, extra_in: float = 0.85
) -> tuple[Figure, list[Axes]]:
    """A figure of maps side by side, the outer ones labelled, with `extra_in` for legend and titles."""
    columns = min(columns, n_panels)
    rows = -(-n_panels // columns)
    x_m, y_m = plane_edges_m(grid)
    tall = float(np.clip((y_m[-1] - y_m[0]) / (x_m[-1] - x_m[0]), 0.25, 2.5))
    panel_in = (width_in - 1.3) / columns
    figure = Figure(figsize=(width_in, rows * (panel_in * tall + 0.45) + extra_in), layout="compressed")
    panels = []
    for i in range(n_panels):
        axes = figure.add_subplot(rows, columns, i + 1)
        axes.set(aspect="equal", xlim=(x_m[0], x_m[-1]), ylim=(y_m[0], y_m[-1]))
        axes.locator_params(nbins=4)
        if columns > 1:
            axes.set_xticks(inner_ticks(x_m[0], x_m[-1]))
        # Inner panels share the axes of the outer ones.
        axes.tick_params(labelbottom=i + columns >= n_panels, labelleft=i % columns == 0)
        if i + columns >= n_panels:
            axes.set_xlabel("x, east [m]")
        if i % columns == 0:
            axes.set_ylabel("y, north [m]")
        panels.append(axes)
    return figure, panels


def inner_ticks(low: float, high: float) -> list[float]:
    """Round values between two borders, but none whose label would touch that of the panel beside it."""
    ticks = np.asarray(MaxNLocator(4).tick_values(low, high), dtype=np.float64)
    margin = 0.1 * (high - low)
    inner = ticks[(ticks >= low + margin) & (ticks <= high - margin)]
    return [float(tick) for tick in inner] or [(low + high) / 2]


def trim_height(figure: Figure) -> None:
    """Take away the height that panels of a fixed shape leave blank above themselves and above the legend."""
    figure.draw_without_rendering()
    boxes = [axes.get_tightbbox() for axes in figure.axes if axes.get_label() != "<colorbar>"]
    panels = Bbox.union([box for box in boxes if box is not None])
    tops = [figure.bbox.y1, *(text.get_window_extent().y0 for text in figure.texts)]
    lows = [legend.get_window_extent().y1 for legend in figure.legends] or [figure.bbox.y0]
    blank_in = (min(tops) - panels.y1 + panels.y0 - max(lows)) / figure.dpi - 2 * GAP_IN
    if blank_in > 0:
        figure.set_figheight(figure.get_figheight() - blank_in)


def draw_cells(axes: Axes, grid: Grid, values: NDArray[Any], colours: str | Colormap, low: float, high: float) -> QuadMesh:
    """Colour the cells of one height by `values [y, x]`; NaN stays white."""
    x_m, y_m = plane_edges_m(grid)
    shown = np.ma.masked_invalid(values)
    return axes.pcolormesh(x_m, y_m, shown, cmap=colours, vmin=low, vmax=high, rasterized=True)


def _steps(edges_m: FloatArray) -> FloatArray:
    """Each inner edge twice: a contour over repeated values then runs along the edges of the cells."""
    return np.repeat(edges_m, 2)[1:-1]


def _on_steps(area: BoolArray) -> FloatArray:
    return np.repeat(np.repeat(area, 2, axis=0), 2, axis=1).astype(float)


def hatch_area(axes: Axes, grid: Grid, area: BoolArray, hatch: str, line: str, face: str = "none", zorder: float = 2.0) -> None:
    """Fill (`face`) and hatch the cells in `area [y, x]`."""
    if not area.any():
        return
    x_m, y_m = plane_edges_m(grid)
    filled = axes.contourf(
        _steps(x_m), _steps(y_m), _on_steps(area), levels=[0.5, 1.5], colors=[face], hatches=[hatch], zorder=zorder
    )
    filled.set_edgecolor(line)
    filled.set_linewidth(0)


def outline_area(axes: Axes, grid: Grid, area: BoolArray, colour: str = "white", width: float = 1.2) -> None:
    """Draw the border of `area [y, x]` along the edges of the cells, with a dark rim that shows on any colour."""
    if area.all() or not area.any():
        return
    x_m, y_m = plane_edges_m(grid)
    lines = axes.contour(_steps(x_m), _steps(y_m), _on_steps(area), levels=[0.5], colors=[colour], linewidths=[width], zorder=3.0)
    lines.set(path_effects=[patheffects.Stroke(linewidth=width + 1.0, foreground="0.15"), patheffects.Normal()])
