"""Figures of a map that belongs to no run: what `map show` and `map compare` draw."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps import RadioMap, grid_of
from cellpilot.maps.reasons import blocked_cells
from cellpilot.maps.words import share_below
from cellpilot.report.map_marks import draw_scale_and_north, white_handle
from cellpilot.report.map_panels import Panel, draw_panels, mark_handles
from cellpilot.report.maps import sinr_map_figure
from cellpilot.report.plane import chosen_heights, draw_cells, trim_height
from cellpilot.report.serving import draw_serving
from cellpilot.report.style import (
    BLUE,
    CHANCE_COLOURS,
    GREEN,
    GREY,
    ORANGE,
    PURPLE,
    VERMILION,
    drawing_settings,
    legend_below,
    single_axes,
)
from cellpilot.signal import NO_NOISE_DB
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
    check_known(radio_map)
    if what == "sinr":
        return sinr_map_figure(radio_map, threshold_db)
    with drawing_settings():
        if what == "cdf":
            return _draw_cdf(radio_map, threshold_db)
        if what == "serving":
            return draw_serving(radio_map)
        return _draw_view(radio_map, VIEWS[what](radio_map, threshold_db, noise_std_db))


def check_known(radio_map: RadioMap) -> None:
    """`InputError` for a map without a single value."""
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

    def panel(iz: int) -> Panel:
        draw = lambda axes: draw_cells(axes, grid, view.values[iz], view.colours, view.low, view.high)
        return Panel(draw, iz, f"{grid.z_m[iz]:g} m")

    figure, panels, meshes = draw_panels(grid, [panel(iz) for iz in heights], radio_map)
    draw_scale_and_north(panels[0], grid)
    figure.colorbar(meshes[-1], ax=panels, label=view.label, pad=0.02)
    white = np.isnan(view.values) & np.isfinite(radio_map["sinr_db"].values) & ~blocked_cells(radio_map)
    between = [white_handle(view.white)] if white[heights].any() else []
    handles = mark_handles(radio_map, grid, heights, *between)
    legend_below(figure, handles, columns=3)
    trim_height(figure)
    return figure


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
