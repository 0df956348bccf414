"""Figures of a policy: its action and its value in every cell, for two goals (Figures 5.4 to 5.7)."""

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from numpy.typing import NDArray

from cellpilot.policies import LearnedPolicy
from cellpilot.report.map_marks import draw_special_cells, outline_handle, special_handles
from cellpilot.report.plane import draw_cells, outline_area, plane_panels
from cellpilot.report.style import GREEN, SINR_COLOURS, legend_below
from cellpilot.runs.content import Content
from cellpilot.solve import optimal_values
from cellpilot.world import World

SHADE = LinearSegmentedColormap.from_list("shade", ["1.0", "0.62"])
"""From white (never low) to a grey on which black arrows stay legible."""

ARROWS_PER_SIDE = 24
"""More cells than this along a side, and only every second, third, ... is given an arrow."""


def chosen_goals(world: World, threshold_db: float) -> tuple[int, int]:
    """Two goals: amid the cells most likely, and amid those least likely to be below the threshold.

    Of the cells in the largest connected part that can be left in the most horizontal directions, the one with the highest
    (lowest) chance of low SINR; then with the highest (lowest) mean chance around it; then of the lowest (highest)
    mean SINR; then the lowest number.
    """
    candidates = world.airspace.free_cells
    part = world.airspace.part[candidates]
    candidates = candidates[part == np.bincount(part).argmax()]
    level = world.airspace.moves.array[:, 2] == 0
    ways = (world.airspace.next_cell[:, level] != np.arange(world.grid.n_cells)[:, None])[candidates].sum(-1)
    candidates = candidates[ways == ways.max()]
    chance = world.outage_probability(threshold_db).round(9)
    around = chance[world.airspace.next_cell[candidates]].mean(-1).round(9)
    # lexsort orders by its last key first.
    order = np.lexsort((candidates, world.signal.mean_db[candidates], -around, -chance[candidates]))
    reverse = np.lexsort((candidates, -world.signal.mean_db[candidates], around, chance[candidates]))
    return int(candidates[order[0]]), int(candidates[reverse[0]])


def meaningful_cells(world: World, goal: int) -> NDArray[np.bool_]:
    """Cells `[n_cells]` where an action towards the goal means something: free, connected to it, not the goal itself."""
    meaningful = (world.airspace.part == world.airspace.part[goal]) & ~world.airspace.blocked
    meaningful[goal] = False
    return meaningful


def actions_and_values(run: Content, goal: int) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Action and value max_a Q `[n_cells]` of the shown policy for the goal; -1 and NaN where they mean nothing."""
    policy, goals = run.shown_policy, np.array([goal], dtype=np.int32)
    if isinstance(policy, LearnedPolicy):
        values = policy.parameters.values(run.world.grid, goals)[:, 0].max(-1).astype(np.float64)
    else:
        values = optimal_values(run.world, run.task, goals)[:, 0].max(-1)
    meaningful = meaningful_cells(run.world, goal)
    actions = policy.action_probabilities(goals)[:, 0].argmax(-1)
    return np.where(meaningful, actions, -1), np.where(meaningful, values, np.nan)


def draw_low_goal(run: Content) -> Figure:
    """Actions and values for the goal in a region of low SINR."""
    return _draw_goal(run, chosen_goals(run.world, run.task.threshold_db)[0])


def draw_high_goal(run: Content) -> Figure:
    """Actions and values for the goal in a region of high SINR."""
    return _draw_goal(run, chosen_goals(run.world, run.task.threshold_db)[1])


def _draw_goal(run: Content, goal: int) -> Figure:
    grid, world = run.world.grid, run.world
    actions, values = actions_and_values(run, goal)
    iz = int(grid.position(goal)[2])
    plane = (len(grid.z_m), *grid.sides[1::-1])
    chance = world.outage_probability(run.task.threshold_db).reshape(plane)[iz]
    action, value = actions.reshape(plane)[iz], values.reshape(plane)[iz]
    figure, (left, right) = plane_panels(grid, 2, columns=2, extra_in=1.75)

    shade = draw_cells(left, grid, chance, SHADE, 0.0, 1.0)
    figure.colorbar(shade, ax=left, label=f"P(SINR < {run.task.threshold_db:g} dB) [1]", location="bottom", shrink=0.9, pad=0.02)
    stride = -(-max(action.shape) // ARROWS_PER_SIDE)
    moves = draw_moves(left, run, action, stride)

    finite = value[np.isfinite(value)]
    low, high = (float(finite.min()), float(finite.max())) if finite.size else (0.0, 1.0)
    mesh = draw_cells(right, grid, value, SINR_COLOURS, low, max(high, low + 1e-6))
    outline_area(right, grid, chance > 0.5, width=0.8)
    figure.colorbar(mesh, ax=right, label="value, max Q [reward]", location="bottom", shrink=0.9, pad=0.02)

    x_m, y_m, z_m = grid.metres(goal)
    for axes in (left, right):
        draw_special_cells(axes, grid, run.radio_map, iz)
        axes.plot(x_m, y_m, "*", markersize=15, markerfacecolor=GREEN, markeredgecolor="black", markeredgewidth=0.9, zorder=5)
    who = "learned, arg max" if isinstance(run.shown_policy, LearnedPolicy) else "optimal, as nothing is learned"
    left.set_title(f"{who}: action" + (f" of every {stride}. cell" if stride > 1 else ""), fontsize=9)
    right.set_title(f"value at {z_m:g} m, goal at ({x_m:g}, {y_m:g}) m", fontsize=9)
    star = Line2D([], [], linestyle="", marker="*", markersize=12, markerfacecolor=GREEN, markeredgecolor="black", label="goal")
    handles: list[Line2D | Patch] = [
        star,
        *moves,
        outline_handle(f"P(SINR < {run.task.threshold_db:g} dB) = 0.5"),
        *special_handles(run.radio_map, [iz]),
    ]
    legend_below(figure, handles, columns=5)
    return figure


def draw_moves(axes: Axes, run: Content, action: NDArray[np.int64], stride: int) -> list[Line2D]:
    """Draw the moves `[y, x]` of every `stride`-th cell: arrows, and symbols for up and down; legend entries of these."""
    grid = run.world.grid
    x_m, y_m = np.meshgrid(grid.x_m, grid.y_m)
    shown = np.zeros(action.shape, dtype=bool)
    shown[stride // 2 :: stride, stride // 2 :: stride] = True
    steps_m = np.abs(np.diff(grid.x_m if len(grid.x_m) > 1 else grid.y_m))
    length_m = 0.75 * stride * float(steps_m[0] if steps_m.size else 1.0)
    step = run.world.airspace.moves.array[action]
    climb = np.where(shown & (action >= 0), step[..., 2], 0)
    level = shown & (action >= 0) & (climb == 0)
    direction = step[level][:, :2] * length_m
    axes.quiver(
        x_m[level],
        y_m[level],
        *direction.T,
        pivot="mid",
        angles="xy",
        scale_units="xy",
        scale=1,
        units="xy",
        width=0.11 * length_m,
        headwidth=4.5,
        headlength=4.5,
        headaxislength=4,
        zorder=3,
    )
    handles = []
    for number, marker, face, label in ((1, "^", "white", "up"), (-1, "v", "black", "down")):
        here = climb == number
        if here.any():
            look: dict[str, Any] = {
                "linestyle": "",
                "marker": marker,
                "markersize": 5,
                "markerfacecolor": face,
                "markeredgecolor": "black",
            }
            axes.plot(x_m[here], y_m[here], zorder=3, **look)
            handles.append(Line2D([], [], label=label, **look))
    return handles
