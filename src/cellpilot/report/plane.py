"""Drawing on one height of a grid: coloured cells, outlined and hatched areas, sites. Everything in metres."""

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import Colormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.grid import Grid
from cellpilot.maps import RadioMap
from cellpilot.maps.reasons import reasons_of
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


UNKNOWN_FREE = "unknown, counts as below"
HATCHES = ("xxx", "///", "\\\\\\", "+++", "ooo")
"""Of reasons that are not for lack of data; where there are more, they repeat."""

Look = tuple[str, str, str]
"""Hatch, color of the hatch and of the face."""


def special_cells(radio_map: RadioMap, iz: int) -> dict[str, tuple[BoolArray, Look]]:
    """Cells of one height `[y, x]` that have no ordinary value, and their look: blocked for each reason, unknown but free."""
    codes, unknown = radio_map["blocked_reason"].values[iz], np.isnan(radio_map["sinr_db"].values[iz])
    found = {UNKNOWN_FREE: ((codes == 0) & unknown, ("...", "0.35", "white"))}
    hatches = cycle(HATCHES)
    for code, reason in enumerate(reasons_of(radio_map), 1):
        hatch = "..." if reason.lack_of_data else next(hatches)
        found[f"blocked: {reason.name}"] = (codes == code, (hatch, "0.35", "0.8"))
    return found


def draw_special_cells(axes: Axes, grid: Grid, radio_map: RadioMap, iz: int) -> None:
    """Mark the blocked and the unknown cells of one height."""
    for area, (hatch, line, face) in special_cells(radio_map, iz).values():
        hatch_area(axes, grid, area, hatch, line, face, zorder=2.5)


def special_handles(radio_map: RadioMap, heights: list[int]) -> list[Patch]:
    """Legend entries of the kinds of special cells that occur on these heights."""
    found = {name: look for iz in heights for name, (area, look) in special_cells(radio_map, iz).items() if area.any()}
    return [
        Patch(facecolor=face, edgecolor=line, hatch=hatch, label=name, linewidth=0)
        for name, (hatch, line, face) in sorted(found.items())
    ]


def sites_inside(radio_map: RadioMap, grid: Grid) -> FloatArray:
    """Different places `[site, 2]` of the sectors within the area [m]."""
    places = site_places_m(radio_map)
    x_m, y_m = plane_edges_m(grid)
    inside = (places[:, 0] >= x_m[0]) & (places[:, 0] <= x_m[-1]) & (places[:, 1] >= y_m[0]) & (places[:, 1] <= y_m[-1])
    return places[inside]


def site_places_m(radio_map: RadioMap) -> FloatArray:
    """Different places `[site, 2]` of all sectors [m], in their order; none for a map without sectors."""
    if "sector_x_m" not in radio_map.coords or "sector_y_m" not in radio_map.coords:
        return np.empty((0, 2))
    places = np.stack([radio_map["sector_x_m"].values, radio_map["sector_y_m"].values], axis=-1).round(3)
    _, first = np.unique(places, axis=0, return_index=True)
    return np.asarray(places[np.sort(first)], dtype=np.float64)


def draw_sites(axes: Axes, places_m: FloatArray) -> None:
    """Mark sites by white triangles."""
    # A line without points has no extent, and the layout gives up on it.
    if not len(places_m):
        return
    axes.plot(*places_m.T, "^", markersize=8, markerfacecolor="white", markeredgecolor="black", zorder=4, clip_on=False)


def site_handle() -> Line2D:
    """Legend entry of a site."""
    return Line2D([], [], linestyle="", marker="^", markersize=8, markerfacecolor="white", markeredgecolor="black", label="site")


def white_handle(label: str) -> Patch:
    """Legend entry of cells that stay white."""
    return Patch(facecolor="white", edgecolor="0.35", linewidth=0.6, label=label)


def outline_handle(label: str) -> Line2D:
    """Legend entry of an outlined area."""
    return Line2D(
        [],
        [],
        color="white",
        linewidth=1.2,
        label=label,
        path_effects=[patheffects.Stroke(linewidth=2.2, foreground="0.15"), patheffects.Normal()],
    )


def draw_boresights(axes: Axes, radio_map: RadioMap, length_m: float) -> None:
    """Short lines from the sites along the boresights of their sectors."""
    if "sector_boresight_deg" not in radio_map.coords or "sector_x_m" not in radio_map.coords:
        return
    angle = np.radians(radio_map["sector_boresight_deg"].values)
    x_m, y_m = radio_map["sector_x_m"].values, radio_map["sector_y_m"].values
    ends_x_m, ends_y_m = x_m + length_m * np.cos(angle), y_m + length_m * np.sin(angle)
    rim = [patheffects.Stroke(linewidth=2.6, foreground="black"), patheffects.Normal()]
    axes.plot(np.stack([x_m, ends_x_m]), np.stack([y_m, ends_y_m]), color="white", linewidth=1.2, zorder=3.8, path_effects=rim)


def draw_scale_and_north(axes: Axes, grid: Grid) -> None:
    """A scale bar of a round length in the lower left, and an arrow to the north in the upper right."""
    x_m, y_m = plane_edges_m(grid)
    width_m, height_m = x_m[-1] - x_m[0], y_m[-1] - y_m[0]
    length_m = round_length_m(0.3 * width_m)
    left_m, low_m = x_m[0] + 0.05 * width_m, y_m[0] + 0.06 * height_m
    rim = [patheffects.Stroke(linewidth=5, foreground="white"), patheffects.Normal()]
    text_rim = [patheffects.Stroke(linewidth=2.5, foreground="white"), patheffects.Normal()]
    arrow_rim = [patheffects.Stroke(linewidth=3.9, foreground="white"), patheffects.Normal()]
    axes.plot(
        [left_m, left_m + length_m],
        [low_m, low_m],
        color="black",
        linewidth=2.5,
        zorder=5,
        path_effects=rim,
        solid_capstyle="butt",
    )
    label = f"{length_m / 1000:g} km" if length_m >= 1000 else f"{length_m:g} m"
    axes.text(
        left_m + length_m / 2,
        low_m + 0.025 * height_m,
        label,
        ha="center",
        va="bottom",
        fontsize=8,
        zorder=5,
        path_effects=text_rim,
    )
    axes.annotate(
        "N",
        xy=(0.94, 0.97),
        xytext=(0.94, 0.83),
        xycoords="axes fraction",
        ha="center",
        va="center",
        fontsize=8,
        zorder=5,
        arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.4, "path_effects": arrow_rim},
        path_effects=text_rim,
    )


def round_length_m(about_m: float) -> float:
    """The greatest of 1, 2 and 5 times a power of ten that is not above a length [m], but for rounding."""
    # The logarithm of a length just below a power of ten is that of the power.
    about_m *= 1 + 1e-9
    power = 10.0 ** np.floor(np.log10(about_m))
    return float(power * max(step for step in (1, 2, 5) if step * power <= about_m))
