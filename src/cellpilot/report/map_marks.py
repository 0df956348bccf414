"""What is drawn upon a map: cells without a value, sites, boresights, scale and north arrow, and their legend entries."""

from itertools import cycle

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from cellpilot.array_types import FloatArray
from cellpilot.grid import Grid
from cellpilot.maps import RadioMap
from cellpilot.maps.reasons import reasons_of
from cellpilot.report.plane import BoolArray, hatch_area, plane_edges_m

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
