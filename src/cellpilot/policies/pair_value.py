"""The value network over pairs of cells, and how its values become action values: arithmetic that NumPy and JAX share.

A pair (cell, goal) is described by rows of one table, one row for each of: the cell, the goal, every pair of a coordinate
of the cell with one of the goal, and the offset from cell to goal. The network adds its rows, and two rectified layers
turn the sum into one number, the correction to a value that is known without any radio.
"""

from functools import reduce
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import ENTERED, MOVED, Airspace
from cellpilot.errors import InputError
from cellpilot.grid import IntArray
from cellpilot.task import Task

ARCHITECTURE = "pair-value"
PAIR_TENSORS = {"table", "weight", "bias", "output", "blocked"}
"""Tensors of a policy of this kind; `penalty` besides, where a penalty model was learned."""

GOALS_OF_PAIRS_AT_ONCE = 8
MOST_PAIRS_VALUED = 1_000_000
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


def distance(sides: Sides, cell: Any, goal: Any, diagonal: bool = False) -> Any:
    """Moves between cell and goal where nothing is blocked: a lower bound of the moves where something is.

    `diagonal`: a move may change several coordinates at once.
    """
    here, there = _coordinates(sides, cell), _coordinates(sides, goal)
    away = [abs(a - b) for a, b in zip(here, there, strict=True)]
    greater = lambda a, b: (a + b + abs(a - b)) // 2  # what NumPy, JAX and ONNX have in common
    return reduce(greater, away) if diagonal else sum(away)


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
    tensors: dict[str, NDArray[Any]], airspace: Airspace, task: Task, goals: IntArray, look_ahead: int = 1
) -> NDArray[np.float32]:
    """Q(cell, goal, action) `[n_cells, goals, actions]` in float32: the reward of the move and the value of where it leads.

    With a penalty model the reward is the learned one, and the value of where it leads is that of the best `look_ahead - 1`
    further moves and of the network behind them; without, the network has learned the value of *entering* a cell.
    """
    grid = airspace.grid
    if tensors["table"].shape[-2] != n_rows(grid.sides):
        raise InputError(f"the policy's tensors do not fit a grid of {grid.sides} cells; train again or restore it")
    next_cell, of_move = airspace.next_cell, move_rewards(airspace, task)
    values = np.empty((grid.n_cells, len(goals), airspace.n_actions), np.float32)
    at_once = max(1, min(GOALS_OF_PAIRS_AT_ONCE, MOST_PAIRS_VALUED // grid.n_cells))
    for i in range(0, len(goals), at_once):
        block = np.asarray(goals[i : i + at_once])
        entering = _entering_values(tensors, airspace, task, block)
        reward, over = _entering_reward(tensors, airspace, task, block)
        for _ in range(look_ahead - 1):
            best = (entering[next_cell] + of_move[..., None]).max(1)
            entering = (reward + np.float32(task.discount) * np.where(over, 0, best)).astype(np.float32)
        values[:, i : i + at_once] = entering[next_cell].transpose(0, 2, 1)
    return values + of_move[:, None, :]


def move_rewards(airspace: Airspace, task: Task) -> NDArray[np.float32]:
    """The part of the reward that the move decides, `[n_cells, actions]`; -inf for a move that is not offered."""
    cell, action = np.arange(airspace.grid.n_cells)[:, None], np.arange(airspace.n_actions)[None, :]
    reward = task.move_reward(cell, action, airspace.next_cell, airspace.event)
    return np.where(airspace.offered, reward, -np.inf).astype(np.float32)


def _entering_values(tensors: dict[str, NDArray[Any]], airspace: Airspace, task: Task, goals: IntArray) -> NDArray[np.float32]:
    grid = airspace.grid
    cell, goal = np.arange(grid.n_cells)[:, None], goals[None, :]
    rows = pair_rows(grid.sides, cell, goal)
    hidden = tensors["table"][..., rows[0], :]
    for row in rows[1:]:
        hidden = hidden + tensors["table"][..., row, :]
    hidden = np.maximum(hidden, 0)
    weight, bias, output = (tensors[name][:, None] for name in ("weight", "bias", "output"))  # [networks, 1, ...]
    hidden = np.maximum(hidden @ weight + bias[:, None], 0)
    correction = (hidden @ output[..., None])[..., 0].min(0)  # of several networks the least value counts
    steps = distance(grid.sides, cell, goal, airspace.moves.diagonal).astype(np.float32)
    penalty = tensors.get("penalty")
    bound = upper_bound(task, steps, 0.0 if penalty is None else penalty[goals][None, :])
    reward, over = _entering_reward(tensors, airspace, task, goals)
    if penalty is None:
        most = reward + task.discount * bound
        return np.where(airspace.blocked[:, None] & airspace.ends, reward, np.minimum(most + correction, most)).astype(np.float32)
    value = np.where(over, 0, np.minimum(bound + correction, bound))
    return (reward + task.discount * value).astype(np.float32)


def _entering_reward(
    tensors: dict[str, NDArray[Any]], airspace: Airspace, task: Task, goals: IntArray
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    """Reward of entering each cell, with the learned penalty where there is one, and whether the flight is over then."""
    cell, goal = np.arange(airspace.grid.n_cells)[:, None], goals[None, :]
    entered = np.where(airspace.blocked & airspace.ends, ENTERED, MOVED)[:, None]
    reached, over = task.end(cell, entered, goal)
    return task.entering_reward(cell, tensors["penalty"][:, None] if "penalty" in tensors else 0.0, reached), over


def _coordinates(sides: Sides, cell: Any) -> tuple[Any, Any, Any]:
    nx, ny, _ = sides
    return cell % nx, cell // nx % ny, cell // (nx * ny)


def _layout(sides: Sides) -> list[int]:
    """First row of each part of the table, and the number of all rows."""
    n = sides[0] * sides[1] * sides[2]
    used = [side for side in sides if side > 1]
    sizes = [n, n, *(a * b for a in used for b in used), int(np.prod([2 * side - 1 for side in used]))]
    return [0, *np.cumsum(sizes).tolist()]
