"""Figures of a map that belongs to no run: what `map show` and `map compare` draw."""

from collections.abc import Callable, Sequence
from textwrap import fill
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps import RadioMap, grid_of
from cellpilot.maps.reasons import blocked_cells
from cellpilot.maps.words import share_below
from cellpilot.report.maps import mark_on_bar, sinr_map_figure
from cellpilot.report.plane import (
    chosen_heights,
    draw_boresights,
    draw_cells,
    draw_scale_and_north,
    draw_sites,
    draw_special_cells,
    outline_area,
    outline_handle,
    plane_edges_m,
    plane_panels,
    site_handle,
    sites_inside,
    special_handles,
    trim_height,
    white_handle,
)
from cellpilot.report.style import (
    BLUE,
    CHANCE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    SINR_COLOURS,
    VERMILION,
    as_drawn,
    drawing_settings,
    legend_below,
    single_axes,
)
from cellpilot.signal import NO_NOISE_DB
from cellpilot.text import visible
from cellpilot.world import World


class View(NamedTuple):
    """One quantity over the cells `[z, y, x]`: its values, colours, limits and the label of the colour bar.

    `white` says in the legend what a cell of known SINR without a value is.
    """

    values: FloatArray
    colours: str
    low: float
    high: float
    label: str
    white: str = "no value"


def heights_left_out(radio_map: RadioMap) -> str:
    """Which heights the pictures of a map show, in words, where these are not all; else nothing."""
    heights_m = radio_map["z"].values
    shown = chosen_heights(len(heights_m))
    if len(shown) == len(heights_m):
        return ""
    return f" ({len(shown)} of {len(heights_m)} heights: {', '.join(f'{heights_m[iz]:g}' for iz in shown)} m)"


def draw_map(radio_map: RadioMap, what: str, threshold_db: float, noise_std_db: float = NO_NOISE_DB) -> Figure:
    """The picture of one quantity of a map; `InputError` for one that the map does not have. Save it with `save_figure`."""
    _check_known(radio_map)
    if what == "sinr":
        return sinr_map_figure(radio_map, threshold_db)
    with drawing_settings():
        if what == "cdf":
            return _draw_cdf(radio_map, threshold_db)
        if what == "serving":
            return _draw_serving(radio_map)
        return _draw_view(radio_map, VIEWS[what](radio_map, threshold_db, noise_std_db))


def _check_known(radio_map: RadioMap) -> None:
    if not np.isfinite(radio_map["sinr_db"].values).any():
        raise InputError("the map knows the SINR of no cell: nothing to draw")


def _probability(radio_map: RadioMap, threshold_db: float, noise_std_db: float) -> View:
    chance = World.from_map(radio_map, noise_std_db).outage_probability(threshold_db).reshape(radio_map["sinr_db"].shape)
    return View(chance, CHANCE_COLOURS, 0.0, 1.0, f"P(SINR < {threshold_db:g} dB) in one step [1]")


def _variable(name: str, label: str, amount: str, white: str = "no value") -> Callable[[RadioMap, float, float], View]:
    """A variable of the map; `amount` says in words how much of it, `{:g}`, a cell has."""

    def view(radio_map: RadioMap, threshold_db: float, noise_std_db: float) -> View:
        if name not in radio_map:
            raise InputError(f"the map has no {name}: nothing to draw")
        values = np.where(np.isnan(radio_map["sinr_db"].values), np.nan, radio_map[name].values.astype(np.float64))
        if np.isnan(values).all():
            raise InputError(f"the map has no {name} in any cell: nothing to draw")
        low, high = float(np.nanmin(values)), float(np.nanmax(values))
        if np.isclose(low, high):
            cells = "known cell" if np.isnan(values).any() else "cell"
            raise InputError(f"every {cells} has {amount.format(high)}: nothing to draw")
        return View(values, "magma_r", 0.0, high, label, white)

    return view


VIEWS: dict[str, Callable[[RadioMap, float, float], View]] = {
    "probability": _probability,
    "uncertainty": _variable("sinr_std_db", "uncertainty of\nthe mean SINR [dB]", "an uncertainty of {:g} dB"),
    "spread": _variable(
        "sinr_spread_db", "standard deviation\nwithin a cell [dB]", "a spread of {:g} dB", "fewer than two samples"
    ),
    "count": _variable("count", "samples in a cell [1]", "{:g} samples"),
}


def _draw_view(radio_map: RadioMap, view: View) -> Figure:
    grid = grid_of(radio_map)
    heights = chosen_heights(len(grid.z_m))
    figure, panels = plane_panels(grid, len(heights), width_in=4.6 if len(heights) == 1 else 6.3)
    sites = sites_inside(radio_map, grid)
    for axes, iz in zip(panels, heights, strict=True):
        mesh = draw_cells(axes, grid, view.values[iz], view.colours, view.low, view.high)
        draw_special_cells(axes, grid, radio_map, iz)
        draw_boresights(axes, radio_map, 0.08 * (grid.x_m[-1] - grid.x_m[0]))
        draw_sites(axes, sites)
        axes.set_title(f"{grid.z_m[iz]:g} m")
    draw_scale_and_north(panels[0], grid)
    figure.colorbar(mesh, ax=panels, label=view.label, pad=0.02)
    white = np.isnan(view.values) & np.isfinite(radio_map["sinr_db"].values) & ~blocked_cells(radio_map)
    handles = [
        *([site_handle()] if len(sites) else []),
        *([white_handle(view.white)] if white[heights].any() else []),
        *special_handles(radio_map, heights),
    ]
    legend_below(figure, handles, columns=3)
    trim_height(figure)
    return figure


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


def _draw_serving(radio_map: RadioMap) -> Figure:
    if "serving_sector" not in radio_map:
        raise InputError("the map does not say which sector serves: nothing to draw")
    grid = grid_of(radio_map)
    heights = chosen_heights(len(grid.z_m))
    serving = radio_map["serving_sector"].values
    figure, panels = plane_panels(grid, len(heights), width_in=4.6 if len(heights) == 1 else 6.3)
    n_colours = len(SECTOR_COLOURS)
    sites = sites_inside(radio_map, grid)
    length_m = 0.08 * (grid.x_m[-1] - grid.x_m[0])
    drawn = [_largest_pieces(serving[iz]) for iz in heights]
    names = _short_names(radio_map, sorted({sector for pieces in drawn for sector in pieces}))
    for axes, iz, pieces in zip(panels, heights, drawn, strict=True):
        shown = np.where(serving[iz] < 0, np.nan, serving[iz] % n_colours)
        mesh = draw_cells(axes, grid, shown, ListedColormap(SECTOR_COLOURS), -0.5, n_colours - 0.5)
        mesh.set_norm(BoundaryNorm(np.arange(n_colours + 1) - 0.5, n_colours))
        labels = {names.get(sector, str(sector)): cells for sector, cells in pieces.items()}
        _label_pieces(axes, grid, labels, sites, scale=axes is panels[0])
        draw_special_cells(axes, grid, radio_map, iz)
        draw_boresights(axes, radio_map, length_m)
        draw_sites(axes, sites)
        found = len(np.unique(serving[iz][serving[iz] >= 0]))
        axes.set_title(f"{grid.z_m[iz]:g} m: {found} serving sectors")
    draw_scale_and_north(panels[0], grid)
    handles = [
        *([site_handle()] if len(sites) else []),
        *([_label_handle(bool(names))] if any(drawn) else []),
        *special_handles(radio_map, heights),
    ]
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


CURVES = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (PURPLE, ":"), (ORANGE, (0, (5, 1, 1, 1))), (GREY, (0, (1, 1))))


def _draw_cdf(radio_map: RadioMap, threshold_db: float) -> Figure:
    figure, axes = single_axes(5.2, 3.4)
    heights = chosen_heights(radio_map.sizes["z"])
    for (colour, style), iz in zip(CURVES, heights, strict=False):
        values = radio_map["sinr_db"].values[iz][~blocked_cells(radio_map)[iz]]
        values = np.sort(values[np.isfinite(values)])
        share = share_below(radio_map, iz, threshold_db)
        if values.size:
            unknown = f", {share.unknown} of {share.free} cells unknown" if share.unknown else ""
            axes.plot(
                values,
                (share.unknown + np.arange(1, values.size + 1)) / share.free,
                color=colour,
                linestyle=style,
                label=f"{radio_map['z'].values[iz]:g} m{unknown}",
            )
    axes.axvline(threshold_db, color="black", linewidth=1.0, linestyle="--")
    axes.text(threshold_db, 1.01, f"{threshold_db:g} dB", ha="center", va="bottom", fontsize=8)
    axes.set(xlabel="mean SINR of a free cell [dB]", ylabel="share of cells below [1]", ylim=(0, 1))
    if axes.get_legend_handles_labels()[0]:
        axes.legend(title="height")
    return figure


TITLE_WIDTH = 22
"""Characters in a line above a panel of a comparison."""


def draw_comparison(a: RadioMap, b: RadioMap, names: Sequence[str], threshold_db: float) -> Figure:
    """Both maps and B less A at each height (up to six, see `heights_left_out`); the threshold outlined."""
    for each in (a, b):
        _check_known(each)
    names = [as_drawn(name) for name in names]
    with drawing_settings():
        grid = grid_of(a)
        heights = chosen_heights(len(grid.z_m))
        values = [each["sinr_db"].values for each in (a, b)]
        known = np.concatenate([v[np.isfinite(v)] for v in values])
        difference = values[1] - values[0]
        span = max(float(np.nanpercentile(np.abs(difference), 99)), 0.1) if np.isfinite(difference).any() else 1.0
        figure, panels = plane_panels(grid, 3 * len(heights), 3, width_in=7.2)
        for row, iz in enumerate(heights):
            for column in range(2):
                axes = panels[3 * row + column]
                mesh = draw_cells(axes, grid, values[column][iz], SINR_COLOURS, float(known.min()), float(known.max()))
                outline_area(axes, grid, values[column][iz] < threshold_db)
                axes.set_title(fill(f"{names[column]}, {grid.z_m[iz]:g} m", TITLE_WIDTH))
            axes = panels[3 * row + 2]
            change = draw_cells(axes, grid, difference[iz], "RdBu", -span, span)
            axes.set_title(fill(f"{names[1]} less {names[0]}", TITLE_WIDTH))
        draw_scale_and_north(panels[0], grid)
        bar = figure.colorbar(mesh, ax=panels, label="mean SINR [dB]", pad=0.02, shrink=0.9)
        mark_on_bar(bar, threshold_db)
        figure.colorbar(change, ax=panels, label="difference [dB]", pad=0.02, shrink=0.9, extend="both")
        white = [white_handle("not known")] if np.isnan(difference[heights]).any() else []
        legend_below(figure, [outline_handle(f"threshold {threshold_db:g} dB"), *white])
        trim_height(figure)
        return figure
