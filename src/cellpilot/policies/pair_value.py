"""The value network over pairs of cells, and how its values become action values: arithmetic that NumPy and JAX share.

A pair (cell, goal) is described by rows of one table, one row for each of: the cell, the goal, every pair of a coordinate
of the cell with one of the goal, and the offset from cell to goal. The network adds its rows, and two rectified layers
turn the sum into one number, the correction to a value that is known without any radio.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.grid import Grid, IntArray
from cellpilot.task import Task

ARCHITECTURE = "pair-value"
TENSORS = {"table", "weight", "bias", "output", "blocked"}
"""Tensors of a policy of this kind; `penalty` besides, where a penalty model was learned."""

GOALS_AT_ONCE = 8
MOST_PAIRS = 1_000_000
Sides = tuple[int, int, int]


def n_rows(sides: Sides) -> int:
    """Rows of the table: 3,921 for 20 x 20 cells, 19,714 for 20 x 20 x 5."""
    return _layout(sides)[-1]


def pair_rows(sides: Sides, cell: Any, goal: Any) -> list[Any]:
    """Rows of the table that describe each pair; `cell` and `goal` broadcast against each other."""
    here, there = _coordinates(sides, cell), _coordinates(sides, goal)
    axes = [axis for axis in range(3) if sides[axis] > 1]
    *starts, _ = _layout(sides)
    columns = [cell + 0 * goal, goal + 0 * cell]
    columns += [here[i] * sides[j] + there[j] for i in axes for j in axes]
    offset = 0
    for i in axes:
        offset = offset * (2 * sides[i] - 1) + (here[i] - there[i] + sides[i] - 1)
    return [start + column for start, column in zip(starts, [*columns, offset], strict=True)]


def distance(sides: Sides, cell: Any, goal: Any) -> Any:
    """Moves between cell and goal where nothing is blocked: a lower bound of the moves where something is."""
    here, there = _coordinates(sides, cell), _coordinates(sides, goal)
    return sum(abs(a - b) for a, b in zip(here, there, strict=True))


def neighbour(sides: Sides, cell: Any, offsets: Any) -> Any:
    """The cells at `offsets [3, ...]` from each cell, moved to the border where they lie outside."""
    x, y, z = (
        (here + offset).clip(0, side - 1) for here, offset, side in zip(_coordinates(sides, cell), offsets, sides, strict=True)
    )
    return (z * sides[1] + y) * sides[0] + x


def penalty_free_value(task: Task, steps: Any) -> Any:
    """Discounted return of a flight that needs `steps` moves and never meets low SINR; it bounds the value from above."""
    gamma = task.discount
    moving = steps if gamma == 1 else (1 - gamma**steps) / (1 - gamma)
    return task.rho_goal * gamma ** (steps - 1) + task.rho_step * moving


def upper_bound(task: Task, steps: Any, goal_penalty: Any) -> Any:
    """Value of a cell if only the goal itself cost its penalty `[0, 1]` on entering; 0 in the goal, where flights end."""
    value = penalty_free_value(task, 1.0 * steps) + task.rho_sinr * task.discount ** (1.0 * steps - 1) * goal_penalty
    return value * (steps > 0)


def pair_action_values(
    tensors: dict[str, NDArray[Any]], grid: Grid, task: Task, goals: IntArray, look_ahead: int = 1
) -> NDArray[np.float32]:
    """Q(cell, goal, action) `[n_cells, goals, actions]` in float32: the reward of the move and the value of where it leads.

    With a penalty model the reward is the learned one, and the value of where it leads is that of the best `look_ahead - 1`
    further moves and of the network behind them; without, the network has learned the value of *entering* a cell.
    """
    if tensors["table"].shape[-2] != n_rows(grid.sides) or tensors["blocked"].shape != (grid.n_cells,):
        raise InputError(f"the policy's tensors do not fit a grid of {grid.sides} cells; train again or restore it")
    next_cell, stopped = grid.next_cells(tensors["blocked"].astype(bool))
    values = np.empty((grid.n_cells, len(goals), grid.n_actions), np.float32)
    at_once = max(1, min(GOALS_AT_ONCE, MOST_PAIRS // grid.n_cells))
    for i in range(0, len(goals), at_once):
        block = np.asarray(goals[i : i + at_once])
        entering = _entering_values(tensors, grid, task, block)
        at_goal = np.arange(grid.n_cells)[:, None] == block[None, :]
        for _ in range(look_ahead - 1):
            best = (entering[next_cell] + np.float32(task.rho_blocked) * stopped[..., None]).max(1)
            entering = (_reward(tensors, task, at_goal) + np.float32(task.discount) * best * ~at_goal).astype(np.float32)
        values[:, i : i + at_once] = entering[next_cell].transpose(0, 2, 1)
    return values + np.float32(task.rho_blocked) * stopped[:, None, :].astype(np.float32)


def _entering_values(tensors: dict[str, NDArray[Any]], grid: Grid, task: Task, goals: IntArray) -> NDArray[np.float32]:
    cell, goal = np.arange(grid.n_cells)[:, None], goals[None, :]
    rows = pair_rows(grid.sides, cell, goal)
    hidden = tensors["table"][..., rows[0], :]
    for row in rows[1:]:
        hidden = hidden + tensors["table"][..., row, :]
    hidden = np.maximum(hidden, 0)
    weight, bias, output = (tensors[name][:, None] for name in ("weight", "bias", "output"))  # [networks, 1, ...]
    hidden = np.maximum(hidden @ weight + bias[:, None], 0)
    correction = (hidden @ output[..., None])[..., 0].min(0)  # of several networks the least value counts
    at_goal = cell == goal
    steps = distance(grid.sides, cell, goal).astype(np.float32)
    penalty = tensors.get("penalty")
    bound = upper_bound(task, steps, 0.0 if penalty is None else penalty[goals][None, :])
    reward = _reward(tensors, task, at_goal)
    if penalty is None:
        most = reward + task.discount * bound
        return np.minimum(most + correction, most).astype(np.float32)
    value = np.minimum(bound + correction, bound) * ~at_goal
    return (reward + task.discount * value).astype(np.float32)


def _reward(tensors: dict[str, NDArray[Any]], task: Task, at_goal: NDArray[np.bool_]) -> NDArray[Any]:
    """Reward of entering each cell, the learned penalty included where there is one."""
    reward = task.rho_step + task.rho_goal * at_goal
    return reward + task.rho_sinr * tensors["penalty"][:, None] if "penalty" in tensors else reward


def _coordinates(sides: Sides, cell: Any) -> tuple[Any, Any, Any]:
    nx, ny, _ = sides
    return cell % nx, cell // nx % ny, cell // (nx * ny)


def _layout(sides: Sides) -> list[int]:
    """First row of each part of the table, and the number of all rows."""
    n = sides[0] * sides[1] * sides[2]
    used = [side for side in sides if side > 1]
    sizes = [n, n, *(a * b for a in used for b in used), int(np.prod([2 * side - 1 for side in used]))]
    return [0, *np.cumsum(sizes).tolist()]
