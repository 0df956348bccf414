"""Figures of the place: the deployment, the SINR map and the chance of low SINR (Figures 4.1 to 4.6)."""

from dataclasses import replace

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.colorbar import Colorbar
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch, Polygon, Rectangle
from numpy.typing import NDArray

from cellpilot.grid import Grid
from cellpilot.maps import RadioMap, grid_of
from cellpilot.maps.words import share_below
from cellpilot.report.map_marks import (
    draw_scale_and_north,
    draw_sites,
    outline_handle,
    site_handle,
    site_places_m,
    sites_inside,
)
from cellpilot.report.map_panels import Panel, draw_panels, mark_handles
from cellpilot.report.numbers import percent
from cellpilot.report.plane import (
    FloatArray,
    chosen_heights,
    draw_cells,
    hatch_area,
    outline_area,
    plane_edges_m,
    trim_height,
)
from cellpilot.report.style import BLUE, CHANCE_COLOURS, SINR_COLOURS, VERMILION, drawing_settings, legend_below, single_axes
from cellpilot.runs.content import Content
from cellpilot.world import World


def by_height(grid: Grid, values: NDArray[np.generic]) -> NDArray[np.generic]:
    """Values of cells as `[z, y, x]`."""
    return values.reshape(grid.sides[::-1])


def hexagons_m(places_m: FloatArray) -> FloatArray | None:
    """Corners `[site, 6, 2]` of the hexagon around each site [m]; None where the sites are not on a hexagonal lattice."""
    if len(places_m) < 3:
        return None
    offset_m = places_m - places_m[0]
    distance_m = np.hypot(*offset_m.T)
    nearest = 1 + int(distance_m[1:].argmin())
    length_m = distance_m[nearest]
    angle = np.arctan2(*offset_m[nearest][::-1])
    basis = length_m * np.stack([_unit(angle), _unit(angle + np.pi / 3)])
    steps = offset_m @ np.linalg.inv(basis)
    if np.abs(steps - steps.round()).max() > 0.01:
        return None
    corners = _unit(angle + np.pi / 6 + np.arange(6) * np.pi / 3) * length_m / np.sqrt(3)
    return np.asarray(places_m[:, None, :] + corners[None])


def _unit(angle: float | FloatArray) -> FloatArray:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def draw_deployment(run: Content) -> Figure | None:
    """Sites, boresights, hexagons and the outline of the flight area; None for a map without sectors."""
    places_m = site_places_m(run.radio_map)
    if not len(places_m):
        return None
    figure, axes = single_axes(height_in=4.6)
    axes.set(aspect="equal", xlabel="x, east [m]", ylabel="y, north [m]")
    hexagons = hexagons_m(places_m)
    x_m, y_m = plane_edges_m(run.world.grid)
    for corners in hexagons if hexagons is not None else []:
        axes.add_patch(Polygon(corners, closed=True, facecolor="0.96", edgecolor="0.5", linewidth=1.0))
    axes.add_patch(
        Rectangle(
            (x_m[0], y_m[0]), x_m[-1] - x_m[0], y_m[-1] - y_m[0], facecolor="none", edgecolor=BLUE, linestyle="--", linewidth=1.8
        )
    )
    span_m = max(float(np.ptp(places_m, axis=0).max()), float(x_m[-1] - x_m[0]), float(y_m[-1] - y_m[0]))
    handles: list[Line2D | Patch] = [site_handle()]
    if "sector_boresight_deg" in run.radio_map.coords:
        sector_m = np.stack([run.radio_map["sector_x_m"].values, run.radio_map["sector_y_m"].values], axis=-1)
        direction = _unit(np.radians(run.radio_map["sector_boresight_deg"].values)) * 0.11 * span_m
        axes.quiver(
            *sector_m.T, *direction.T, angles="xy", scale_units="xy", scale=1, color=VERMILION, width=0.007, headwidth=4, zorder=3
        )
        handles.append(Line2D([], [], color=VERMILION, marker=">", markersize=5, linewidth=1.6, label="boresight"))
    draw_sites(axes, places_m)
    axes.autoscale_view()
    handles.append(Line2D([], [], color=BLUE, linestyle="--", label="flight area"))
    if hexagons is not None:
        handles.append(Patch(facecolor="0.96", edgecolor="0.5", label="hexagon of a site"))
    legend_below(figure, handles)
    return figure


def draw_sinr(run: Content) -> Figure:
    """Mean SINR of each height; the area below the threshold hatched and outlined."""
    return sinr_map_figure(run.radio_map, run.task.threshold_db)


def sinr_map_figure(radio_map: RadioMap, threshold_db: float) -> Figure:
    """The SINR map of each height as a figure of its own, for a map that belongs to no run; save it with `savefig`."""
    with drawing_settings():
        return _sinr_map(radio_map, threshold_db)


def _sinr_map(radio_map: RadioMap, threshold_db: float) -> Figure:
    grid = grid_of(radio_map)
    heights = chosen_heights(len(grid.z_m))
    sinr_db = radio_map["sinr_db"].values
    known = sinr_db[np.isfinite(sinr_db)]
    low_db, high_db = float(known.min()), max(float(known.max()), float(known.min()) + 1.0)

    def panel(iz: int) -> Panel:
        def draw(axes: Axes) -> QuadMesh:
            mesh = draw_cells(axes, grid, sinr_db[iz], SINR_COLOURS, low_db, high_db)
            below = sinr_db[iz] < threshold_db
            hatch_area(axes, grid, below, "////", "white")
            outline_area(axes, grid, below)
            return mesh

        share = share_below(radio_map, iz, threshold_db)
        unknown = f"\n({share.unknown} of {share.free} unknown)" if share.unknown else ""
        return Panel(draw, iz, f"{grid.z_m[iz]:g} m: {percent(share.share, digits=0)} below{unknown}")

    sites = len(sites_inside(radio_map, grid)) > 0
    figure, panels, meshes = draw_panels(grid, [panel(iz) for iz in heights], radio_map, boresights=sites)
    draw_scale_and_north(panels[0], grid)
    bar = figure.colorbar(meshes[-1], ax=panels, label="mean SINR [dB]", pad=0.02)
    mark_on_bar(bar, threshold_db)
    if len(heights) < len(grid.z_m):
        figure.suptitle(f"{len(heights)} of {len(grid.z_m)} heights")
    handles: list[Line2D | Patch] = [
        Patch(facecolor="#3b5a8b", edgecolor="white", hatch="////", linewidth=0, label=f"SINR below {threshold_db:g} dB"),
        outline_handle(f"threshold {threshold_db:g} dB"),
        *mark_handles(radio_map, grid, heights),
    ]
    legend_below(figure, handles, columns=3)
    trim_height(figure)
    return figure


def mark_on_bar(bar: Colorbar, level: float) -> None:
    """Mark a level on a vertical colour bar."""
    bar.ax.axhline(level, color="white", linewidth=3.2)
    bar.ax.axhline(level, color="black", linewidth=1.4)


def low_probability_maps(world: World, threshold_db: float) -> dict[str, NDArray[np.float64]]:
    """Chance of a measurement below the threshold `[z, y, x]`, without and with noise (once where there is none)."""
    kinds = {"without noise": 0.0}
    signal = world.signal
    if signal.noise_std_db > 0:
        kinds[f"with noise of {signal.noise_std_db:g} dB"] = signal.noise_std_db
    chances = {name: replace(signal, noise_std_db=std_db).outage_probability(threshold_db) for name, std_db in kinds.items()}
    return {name: np.asarray(by_height(world.grid, chance), dtype=float) for name, chance in chances.items()}


def draw_low_probability(run: Content) -> Figure:
    """Chance of low SINR in each cell, one row without and one with noise."""
    grid = run.world.grid
    maps = low_probability_maps(run.world, run.task.threshold_db)
    heights = chosen_heights(len(grid.z_m), at_most=3)
    # One height: without and with noise side by side; several: one row of heights for each.
    columns = len(heights) if len(heights) > 1 else len(maps)

    def panel(name: str, iz: int) -> Panel:
        draw = lambda axes: draw_cells(axes, grid, maps[name][iz], CHANCE_COLOURS, 0.0, 1.0)
        return Panel(draw, iz, name if len(heights) == 1 else f"{grid.z_m[iz]:g} m, {name}", 8.5)

    shown = [panel(name, iz) for name in maps for iz in heights]
    figure, panels, meshes = draw_panels(grid, shown, run.radio_map, columns, boresights=False)
    figure.colorbar(meshes[-1], ax=panels, label=f"P(SINR < {run.task.threshold_db:g} dB) in one step [1]", pad=0.02)
    legend_below(figure, mark_handles(run.radio_map, grid, heights), columns=3)
    trim_height(figure)
    return figure
