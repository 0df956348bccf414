"""The picture of two maps and their difference: what `map compare` draws."""

from collections.abc import Sequence
from textwrap import fill

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import QuadMesh
from matplotlib.figure import Figure

from cellpilot.maps import RadioMap, grid_of
from cellpilot.report.map_marks import draw_scale_and_north, outline_handle, white_handle
from cellpilot.report.map_panels import Panel, draw_panels
from cellpilot.report.map_views import check_known
from cellpilot.report.maps import mark_on_bar
from cellpilot.report.plane import chosen_heights, draw_cells, outline_area, trim_height
from cellpilot.report.style import (
    SINR_COLOURS,
    as_drawn,
    drawing_settings,
    legend_below,
)

TITLE_WIDTH = 22
"""Characters in a line above a panel of a comparison."""


def draw_comparison(a: RadioMap, b: RadioMap, names: Sequence[str], threshold_db: float) -> Figure:
    """Both maps and B less A at each height (up to six, see `heights_left_out`); the threshold outlined."""
    for each in (a, b):
        check_known(each)
    names = [as_drawn(name) for name in names]
    with drawing_settings():
        grid = grid_of(a)
        heights = chosen_heights(len(grid.z_m))
        values = [each["sinr_db"].values for each in (a, b)]
        known = np.concatenate([v[np.isfinite(v)] for v in values])
        difference = values[1] - values[0]
        span = max(float(np.nanpercentile(np.abs(difference), 99)), 0.1) if np.isfinite(difference).any() else 1.0
        low_db, high_db = float(known.min()), float(known.max())

        def of_one(column: int, iz: int) -> Panel:
            def draw(axes: Axes) -> QuadMesh:
                mesh = draw_cells(axes, grid, values[column][iz], SINR_COLOURS, low_db, high_db)
                outline_area(axes, grid, values[column][iz] < threshold_db)
                return mesh

            return Panel(draw, iz, fill(f"{names[column]}, {grid.z_m[iz]:g} m", TITLE_WIDTH))

        def of_both(iz: int) -> Panel:
            draw = lambda axes: draw_cells(axes, grid, difference[iz], "RdBu", -span, span)
            return Panel(draw, iz, fill(f"{names[1]} less {names[0]}", TITLE_WIDTH))

        shown = [panel for iz in heights for panel in (of_one(0, iz), of_one(1, iz), of_both(iz))]
        figure, panels, meshes = draw_panels(grid, shown, None, 3, width_in=7.2)
        mesh, change = meshes[-2:]
        draw_scale_and_north(panels[0], grid)
        bar = figure.colorbar(mesh, ax=panels, label="mean SINR [dB]", pad=0.02, shrink=0.9)
        mark_on_bar(bar, threshold_db)
        figure.colorbar(change, ax=panels, label="difference [dB]", pad=0.02, shrink=0.9, extend="both")
        white = [white_handle("not known")] if np.isnan(difference[heights]).any() else []
        legend_below(figure, [outline_handle(f"threshold {threshold_db:g} dB"), *white])
        trim_height(figure)
        return figure
