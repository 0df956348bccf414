"""The one loop behind all pictures of maps: panels side by side, each a drawing on its axes, with the same marks on all."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cellpilot.grid import Grid
from cellpilot.maps import RadioMap
from cellpilot.report.map_marks import draw_boresights, draw_sites, draw_special_cells, site_handle, sites_inside, special_handles
from cellpilot.report.plane import COLUMNS, plane_panels
from cellpilot.report.style import PAGE_WIDTH_IN

SINGLE_WIDTH_IN = 4.6


class Panel(NamedTuple):
    """One panel: what draws its cells and returns them, the height it shows, and its title."""

    draw: Callable[[Axes], QuadMesh]
    iz: int
    title: str
    title_size: float | None = None  # points; None = as usual


def draw_panels(
    grid: Grid,
    panels: Sequence[Panel],
    radio_map: RadioMap | None,
    columns: int = COLUMNS,
    width_in: float | None = None,
    boresights: bool = True,
) -> tuple[Figure, list[Axes], list[QuadMesh]]:
    """A figure, its panels, and the cells drawn in each; upon them special cells and sites of `radio_map`, None for no marks."""
    if width_in is None:
        width_in = SINGLE_WIDTH_IN if len(panels) == 1 else PAGE_WIDTH_IN
    figure, all_axes = plane_panels(grid, len(panels), columns, width_in=width_in)
    meshes = []
    for axes, panel in zip(all_axes, panels, strict=True):
        meshes.append(panel.draw(axes))
        if radio_map is not None:
            draw_special_cells(axes, grid, radio_map, panel.iz)
            if boresights:
                draw_boresights(axes, radio_map, 0.08 * (grid.x_m[-1] - grid.x_m[0]))
            draw_sites(axes, sites_inside(radio_map, grid))
        title = axes.set_title(panel.title)
        if panel.title_size is not None:
            title.set_fontsize(panel.title_size)
    return figure, all_axes, meshes


def mark_handles(radio_map: RadioMap, grid: Grid, heights: Sequence[int], *between: Line2D | Patch) -> list[Line2D | Patch]:
    """Legend entries of sites, of what stands `between`, and of the special cells on these heights."""
    sites = [site_handle()] if len(sites_inside(radio_map, grid)) else []
    return [*sites, *between, *special_handles(radio_map, list(heights))]
