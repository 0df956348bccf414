"""The picture of the serving sectors of a map, each with a label in its largest piece."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps import RadioMap, grid_of
from cellpilot.report.map_marks import (
    draw_scale_and_north,
    sites_inside,
)
from cellpilot.report.map_panels import Panel, draw_panels, mark_handles
from cellpilot.report.plane import chosen_heights, draw_cells, plane_edges_m, trim_height
from cellpilot.report.style import (
    legend_below,
)
from cellpilot.text import visible

SECTOR_COLOURS = (
    "#0072B2",
    "#E69F00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#D55E00",
    "#F0E442",
    "#9A4C86",
    "#999999",
    "#004D40",
    "#A6761D",
    "#1E1E8F",
)
"""Colours that neighbouring sectors take turns with; where there are more sectors, they repeat."""


def draw_serving(radio_map: RadioMap) -> Figure:
    if "serving_sector" not in radio_map:
        raise InputError("the map does not say which sector serves: nothing to draw")
    grid = grid_of(radio_map)
    heights = chosen_heights(len(grid.z_m))
    serving = radio_map["serving_sector"].values
    n_colours = len(SECTOR_COLOURS)
    sites = sites_inside(radio_map, grid)
    drawn = {iz: _largest_pieces(serving[iz]) for iz in heights}
    names = _short_names(radio_map, sorted({sector for pieces in drawn.values() for sector in pieces}))

    def panel(iz: int) -> Panel:
        def draw(axes: Axes) -> QuadMesh:
            shown = np.where(serving[iz] < 0, np.nan, serving[iz] % n_colours)
            mesh = draw_cells(axes, grid, shown, ListedColormap(SECTOR_COLOURS), -0.5, n_colours - 0.5)
            mesh.set_norm(BoundaryNorm(np.arange(n_colours + 1) - 0.5, n_colours))
            labels = {names.get(sector, str(sector)): cells for sector, cells in drawn[iz].items()}
            _label_pieces(axes, grid, labels, sites, scale=iz == heights[0])
            return mesh

        found = len(np.unique(serving[iz][serving[iz] >= 0]))
        return Panel(draw, iz, f"{grid.z_m[iz]:g} m: {found} serving sectors")

    figure, panels, _ = draw_panels(grid, [panel(iz) for iz in heights], radio_map)
    draw_scale_and_north(panels[0], grid)
    between = [_label_handle(bool(names))] if any(drawn.values()) else []
    handles = mark_handles(radio_map, grid, heights, *between)
    legend_below(figure, handles, columns=3)
    trim_height(figure)
    return figure


MAX_NAME = 8
"""Characters of a sector's name that a picture has room for."""


def _short_names(radio_map: RadioMap, sectors: Sequence[int]) -> dict[int, str]:
    """Names of these sectors if all are short and different; else nothing, and their numbers have to do."""
    if "sector_name" not in radio_map.coords:
        return {}
    names = {sector: str(radio_map["sector_name"].values[sector]).strip() for sector in sectors}
    fit = all(0 < len(name) <= MAX_NAME for name in names.values()) and len(set(names.values())) == len(names)
    return names if fit else {}


def _label_handle(names: bool) -> Line2D:
    """Legend entry of the labels of sectors."""
    label = "name of the serving sector" if names else "number of the serving sector, from 0"
    marker = "$A$" if names else "$0$"
    return Line2D([], [], linestyle="", color="black", marker=marker, markersize=6, markeredgewidth=0.2, label=label)


def _largest_pieces(serving: NDArray[np.int32]) -> dict[int, NDArray[np.intp]]:
    """Cells `[cell, 2]` (row, column) of the largest connected piece of each sector that has room for a label."""
    from scipy.ndimage import label

    found = {}
    for sector in np.unique(serving[serving >= 0]):
        pieces, n = label(serving == sector)
        sizes = np.bincount(pieces.ravel())[1:]
        if n and sizes.max() >= 0.015 * serving.size:
            found[int(sector)] = np.argwhere(pieces == 1 + sizes.argmax())
    return found


def _label_pieces(axes: Axes, grid: Grid, pieces: dict[str, NDArray[np.intp]], sites: FloatArray, scale: bool) -> None:
    """Write each label in its piece, as near to the middle as it clears sites, other labels, and scale and north arrow.

    A label that finds no such place is left out.
    """
    x_m, y_m = plane_edges_m(grid)
    # The layout is not known yet: a panel is about as wide as the page shared out.
    columns = axes.get_subplotspec().get_gridspec().ncols  # type: ignore[union-attr]
    m_per_pt = (x_m[-1] - x_m[0]) / (72 * (axes.figure.get_figwidth() - 1.3) / columns)  # type: ignore[union-attr]
    # Middle, half width and half height of what no label may touch.
    taken = [(x, y, 5.0 * m_per_pt, 5.0 * m_per_pt) for x, y in sites]
    if scale:
        width_m, height_m = x_m[-1] - x_m[0], y_m[-1] - y_m[0]
        taken.append((x_m[0] + 0.2 * width_m, y_m[0] + 0.08 * height_m + 5.0 * m_per_pt, 0.17 * width_m, 8.0 * m_per_pt))
        taken.append((x_m[0] + 0.94 * width_m, y_m[0] + 0.9 * height_m, 5.0 * m_per_pt, 0.1 * height_m))
    for text, cells in pieces.items():
        half_m = (2.8 * len(text) + 1.5) * m_per_pt, 5.0 * m_per_pt
        places_m = np.stack([np.asarray(grid.x_m)[cells[:, 1]], np.asarray(grid.y_m)[cells[:, 0]]], axis=-1)
        from_middle = ((places_m - places_m.mean(axis=0)) ** 2).sum(axis=1)
        clear = np.ones(len(cells), dtype=bool)
        for x, y, half_x_m, half_y_m in taken:
            off_m = np.abs(places_m - (x, y))
            clear &= (off_m[:, 0] >= half_m[0] + half_x_m) | (off_m[:, 1] >= half_m[1] + half_y_m)
        for side, edges_m in enumerate((x_m, y_m)):
            clear &= (places_m[:, side] - half_m[side] >= edges_m[0]) & (places_m[:, side] + half_m[side] <= edges_m[-1])
        if not clear.any():
            continue
        at = places_m[np.where(clear, from_middle, np.inf).argmin()]
        taken.append((*at, *half_m))
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.8}
        label = axes.text(at[0], at[1], visible(text), ha="center", va="center", fontsize=8, zorder=4.5, bbox=box)
        label.set_parse_math(False)
