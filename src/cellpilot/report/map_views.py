"""Figures of a map that belongs to no run: what `map show` and `map compare` draw."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import BoundaryNorm, ListedColormap
from matplotlib.figure import Figure
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps import RadioMap, grid_of
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
    plane_panels,
    site_handle,
    sites_inside,
    special_handles,
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
    drawing_settings,
    legend_below,
    single_axes,
)
from cellpilot.world import World

FloatArray = NDArray[np.float64]


class View(NamedTuple):
    """One quantity over the cells `[z, y, x]`: its values, colours, limits and the label of the colour bar."""

    values: FloatArray
    colours: str
    low: float
    high: float
    label: str


def draw_map(radio_map: RadioMap, what: str, threshold_db: float, noise_std_db: float = 0.0) -> Figure:
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
    chance = World.from_map(radio_map, noise_std_db).low_probability(threshold_db).reshape(radio_map["sinr_db"].shape)
    return View(chance, CHANCE_COLOURS, 0.0, 1.0, f"P(SINR < {threshold_db:g} dB) in one step [1]")


def _variable(name: str, label: str) -> Callable[[RadioMap, float, float], View]:
    def view(radio_map: RadioMap, threshold_db: float, noise_std_db: float) -> View:
        if name not in radio_map:
            raise InputError(f"the map has no {name}: nothing to draw")
        values = np.where(np.isnan(radio_map["sinr_db"].values), np.nan, radio_map[name].values.astype(np.float64))
        if np.isnan(values).all():
            raise InputError(f"the map has no {name} in any cell: nothing to draw")
        return View(values, "magma_r", 0.0, max(float(np.nanmax(values)), 1e-3), label)

    return view


VIEWS: dict[str, Callable[[RadioMap, float, float], View]] = {
    "probability": _probability,
    "uncertainty": _variable("sinr_std_db", "uncertainty of the mean SINR [dB]"),
    "spread": _variable("sinr_spread_db", "standard deviation within a cell [dB]"),
    "count": _variable("count", "samples in a cell [1]"),
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
    legend_below(figure, [*([site_handle()] if len(sites) else []), *special_handles(radio_map, heights)], columns=3)
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
    for axes, iz in zip(panels, heights, strict=True):
        shown = np.where(serving[iz] < 0, np.nan, serving[iz] % n_colours)
        mesh = draw_cells(axes, grid, shown, ListedColormap(SECTOR_COLOURS), -0.5, n_colours - 0.5)
        mesh.set_norm(BoundaryNorm(np.arange(n_colours + 1) - 0.5, n_colours))
        for sector in np.unique(serving[iz][serving[iz] >= 0]):
            _number_largest(axes, grid, serving[iz] == sector, int(sector))
        draw_special_cells(axes, grid, radio_map, iz)
        draw_boresights(axes, radio_map, length_m)
        draw_sites(axes, sites)
        found = len(np.unique(serving[iz][serving[iz] >= 0]))
        axes.set_title(f"{grid.z_m[iz]:g} m: {found} serving sectors")
    draw_scale_and_north(panels[0], grid)
    legend_below(figure, [*([site_handle()] if len(sites) else []), *special_handles(radio_map, heights)], columns=3)
    return figure


def _number_largest(axes: Axes, grid: Grid, area: NDArray[np.bool_], sector: int) -> None:
    """Write a sector's number into the largest connected piece of its area, if that has room for it."""
    from scipy.ndimage import label

    pieces, n = label(area)
    sizes = np.bincount(pieces.ravel())[1:]
    if n and sizes.max() >= 0.015 * area.size:
        inside = np.argwhere(pieces == 1 + sizes.argmax())
        middle = inside[((inside - inside.mean(axis=0)) ** 2).sum(axis=1).argmin()]
        axes.text(
            grid.x_m[middle[1]],
            grid.y_m[middle[0]],
            str(sector),
            ha="center",
            va="center",
            fontsize=8,
            color="black",
            zorder=4.5,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.7, "pad": 0.8},
        )


CURVES = ((BLUE, "-"), (VERMILION, "--"), (GREEN, "-."), (PURPLE, ":"), (ORANGE, (0, (5, 1, 1, 1))), (GREY, (0, (1, 1))))


def _draw_cdf(radio_map: RadioMap, threshold_db: float) -> Figure:
    figure, axes = single_axes(5.2, 3.4)
    heights = chosen_heights(radio_map.sizes["z"])
    for (colour, style), iz in zip(CURVES, heights, strict=False):
        values = radio_map["sinr_db"].values[iz][~radio_map["blocked"].values[iz]]
        values = np.sort(values[np.isfinite(values)])
        if values.size:
            axes.plot(
                values,
                np.arange(1, values.size + 1) / values.size,
                color=colour,
                linestyle=style,
                label=f"{radio_map['z'].values[iz]:g} m",
            )
    axes.axvline(threshold_db, color="black", linewidth=1.0, linestyle="--")
    axes.text(threshold_db, 1.01, f"{threshold_db:g} dB", ha="center", va="bottom", fontsize=8)
    axes.set(xlabel="mean SINR of a free cell [dB]", ylabel="share of cells below [1]", ylim=(0, 1))
    axes.legend(title="height")
    return figure


def draw_comparison(a: RadioMap, b: RadioMap, names: Sequence[str], threshold_db: float) -> Figure:
    """Both maps and B less A at each height (up to three); the threshold outlined."""
    for each in (a, b):
        _check_known(each)
    with drawing_settings():
        grid = grid_of(a)
        heights = chosen_heights(len(grid.z_m), at_most=3)
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
                axes.set_title(f"{names[column]}, {grid.z_m[iz]:g} m")
            axes = panels[3 * row + 2]
            change = draw_cells(axes, grid, difference[iz], "RdBu", -span, span)
            axes.set_title(f"{names[1]} less {names[0]}")
        draw_scale_and_north(panels[0], grid)
        bar = figure.colorbar(mesh, ax=panels, label="mean SINR [dB]", pad=0.02, shrink=0.9)
        mark_on_bar(bar, threshold_db)
        figure.colorbar(change, ax=panels, label="difference [dB]", pad=0.02, shrink=0.9, extend="both")
        legend_below(figure, [outline_handle(f"threshold {threshold_db:g} dB")])
        return figure
