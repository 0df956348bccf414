"""One picture of a flight over its map, for environments that are watched."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellpilot.task import Task
from cellpilot.world import World

WIDTH_IN, HEIGHT_IN, DOTS_PER_INCH = 5.6, 5.2, 80


def draw_flight(world: World, task: Task, path: Sequence[int], goal: int) -> NDArray[np.uint8]:
    """RGB `[416, 448, 3]`: mean SINR at the height flown, cells below the threshold crossed, the path, the drone and the goal.

    What lies at another height (parts of the path, the goal) is drawn pale.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator

    grid = world.grid
    nx, ny, nz = grid.sides
    position, (goal_x, goal_y, goal_z) = grid.position(np.asarray(path)), grid.position(goal)
    here_x, here_y, iz = position[-1]
    plane = lambda values: values.reshape(nz, ny, nx)[iz]
    sinr_db, blocked = plane(world.signal.mean_db), plane(world.airspace.blocked)
    known_db = world.signal.mean_db[np.isfinite(world.signal.mean_db) & ~world.airspace.blocked]
    lowest, highest = (known_db.min(), known_db.max()) if known_db.size else (0.0, 1.0)

    figure = Figure(figsize=(WIDTH_IN, HEIGHT_IN), dpi=DOTS_PER_INCH, layout="constrained")
    canvas = FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set(facecolor="0.75", xlabel="ix, east", ylabel="iy, north", aspect="equal")
    # Grey shows through where a cell is blocked; an unknown cell that may be entered counts as bad, the darkest.
    shown_db = np.ma.masked_where(blocked, np.nan_to_num(sinr_db, neginf=lowest))
    edges = np.arange(nx + 1) - 0.5, np.arange(ny + 1) - 0.5
    image = axes.pcolormesh(*edges, shown_db, cmap="viridis", vmin=lowest, vmax=highest)
    figure.colorbar(image, label="mean SINR [dB]", shrink=0.8)
    low_y, low_x = np.nonzero(~blocked & (sinr_db < task.threshold_db))
    axes.plot(low_x, low_y, "x", color="white", markersize=3, alpha=0.7)

    axes.plot(*position[:, :2].T, color="white", linewidth=2.2, alpha=0.45)
    axes.plot(*np.where(position[:, 2:] == iz, position[:, :2].astype(float), np.nan).T, color="#D55E00", linewidth=2.2)
    axes.plot(*position[0, :2], "s", color="#D55E00", markeredgecolor="black", markersize=7, label="start")
    pale = 1.0 if goal_z == iz else 0.5
    axes.plot(goal_x, goal_y, "*", color="#E69F00", markeredgecolor="black", markersize=17, alpha=pale, label="goal")
    axes.plot(here_x, here_y, "o", color="white", markeredgecolor="black", markersize=9, label="drone")
    axes.xaxis.set_major_locator(MaxNLocator(integer=True))
    axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    height = f" at {grid.z_m[iz]:g} m, goal at {grid.z_m[goal_z]:g} m" if nz > 1 else ""
    axes.set_title(f"step {len(path) - 1} of {task.max_steps}{height}; crosses: below {task.threshold_db:g} dB", fontsize=9)
    figure.legend(loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())[..., :3].copy()
