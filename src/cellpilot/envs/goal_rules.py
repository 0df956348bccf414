"""What the Gymnasium environments of one flight and of many share: spaces, observations, and the outcome for any goal.

A reward depends on what was *measured* in the step, so the facts of a step travel in `info` (`cell`, `action`, `sinr_db`,
`event`, `n_steps`) and a hindsight reward is `Task.outcome` of the same facts with another goal. NumPy only.
"""

import operator
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from cellpilot.airspace import ENTERED, MOVED
from cellpilot.errors import InputError
from cellpilot.grid import IntArray, Position
from cellpilot.task import Task, Transition
from cellpilot.world import World

Observation = dict[str, NDArray[np.float32]]
Info = Mapping[str, Any] | Sequence[Mapping[str, Any]] | NDArray[np.object_]
"""One `info`, one of arrays (vector environments), or a sequence of them (replay buffers)."""


@dataclass(frozen=True)
class GoalRules:
    """A world, a task and the pairs flown, in the words of a goal-conditioned environment.

    `InputError` for a start or goal that is blocked, cut off, or cannot reach the other.
    """

    world: World
    task: Task
    start: Position | None = None  # None = drawn uniformly
    goal: Position | None = None

    def __post_init__(self) -> None:
        _ = self._usual_cells  # raises

    @cached_property
    def _usual_cells(self) -> tuple[IntArray, IntArray]:
        return self.world.airspace.start_goal_cells(self.start, self.goal)

    @cached_property
    def sides(self) -> IntArray:
        """Cells along each dimension flown, `[dims]`."""
        grid = self.world.grid
        return np.asarray(grid.sides[: grid.n_dimensions])

    @cached_property
    def coordinates(self) -> NDArray[np.float32]:
        """Position of every cell, `[n_cells, dims]`: counted from 1, divided by the side, as the project's networks see it."""
        grid = self.world.grid
        position = grid.position(np.arange(grid.n_cells))[:, : grid.n_dimensions]
        return ((position + 1) / self.sides).astype(np.float32)

    @property
    def observation_space(self) -> spaces.Dict:
        """Position, position again as the goal achieved, and the goal desired: from that of the first cell to 1."""
        lowest = (1 / self.sides).astype(np.float32)
        box = lambda: spaces.Box(lowest, np.ones_like(lowest), dtype=np.float32)
        return spaces.Dict({"observation": box(), "achieved_goal": box(), "desired_goal": box()})

    @property
    def action_space(self) -> spaces.Discrete:
        """Moves in the order of `world.airspace.moves`."""
        return spaces.Discrete(self.world.airspace.n_actions)

    @cached_property
    def rewards_follow_from_cells(self) -> bool:
        """Whether the cell entered decides the reward: no noise, no map uncertainty, no reward that depends on the move."""
        signal, airspace = self.world.signal, self.world.airspace
        moves_count = any(price.of == "move" for price in self.task.more) or (
            airspace.blocked.any() and ((airspace.rule == "stay" and self.task.rho_blocked != 0) or airspace.ends)
        )
        return signal.noise_std_db == 0 and signal.unknown is None and not moves_count

    def observation(self, cell: Any, goal: Any) -> Observation:
        """New arrays `[..., dims]` for cells and goals `[...]`."""
        here = self.coordinates[cell]
        return {"observation": here, "achieved_goal": here.copy(), "desired_goal": self.coordinates[goal]}

    def cells(self, coordinates: NDArray[np.floating]) -> IntArray:
        """The nearest cells `[...]` of achieved or desired goals `[..., dims]`; `InputError` for one that lies in none."""
        coordinates = np.asarray(coordinates)
        if coordinates.ndim == 0 or coordinates.shape[-1] != len(self.sides):
            raise InputError(
                f"goals have shape {coordinates.shape}; expected {len(self.sides)} coordinates in the last dimension"
            )
        place = np.rint(coordinates * self.sides - 1)
        inside = (place >= 0) & (place < self.sides)  # NaN is not
        if not inside.all():
            wrong = coordinates[~inside.all(-1)].reshape(-1, len(self.sides))[0].tolist()
            raise InputError(
                f"the goal {wrong} lies in no cell; expected coordinates as in observation_space, from 1 / side to 1"
            )
        nearest = place.astype(np.int64)
        return np.asarray(nearest @ np.cumprod([1, *self.sides[:-1]]))

    def draw_pairs(self, rng: np.random.Generator, n: int, options: Mapping[str, Any] | None = None) -> tuple[IntArray, IntArray]:
        """Starts and goals `[n]`; `options` may fix either for once, as a position `(ix, iy, iz)` under `start` or `goal`."""
        if not options:
            return self.world.airspace.draw_pairs(rng, n, *self._usual_cells)
        if unknown := options.keys() - {"start", "goal"}:
            raise InputError(f"reset: unknown option {sorted(unknown)[0]!r}; expected start or goal, a position (ix, iy, iz)")
        start, goal = place_of(options.get("start", self.start)), place_of(options.get("goal", self.goal))
        return self.world.airspace.draw_pairs(rng, n, *self.world.airspace.start_goal_cells(start, goal))

    def reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Rewards `[...]` of the recorded steps, had they been flown towards the desired goals `[..., dims]`.

        Without facts in `info` the map is looked up, where that gives the same reward; else `InputError`.
        """
        cell = self.cells(achieved_goal)
        before, action, sinr_db, event = (_fact(info, name) for name in ("cell", "action", "sinr_db", "event"))
        if before is None or action is None or sinr_db is None or event is None:
            if not self.rewards_follow_from_cells:
                raise InputError(
                    "compute_reward: info holds no cell, action, sinr_db and event, but the reward depends on them: "
                    "pass the info of each step (Stable-Baselines3: replay_buffer_kwargs={'copy_info_dict': True})"
                )
            before, action, sinr_db, event = (
                cell,
                np.zeros_like(cell),
                self.world.signal.measure(cell),
                np.full(cell.shape, MOVED),
            )
        # float32 as when it was measured, so that a value on the threshold falls on the same side.
        facts = Transition(before, action, cell, sinr_db.astype(np.float32), event)
        return self.task.outcome(facts, self.cells(desired_goal)).reward

    def terminated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any]) -> Any:
        """Whether the flights `[...]` end in these steps, had the desired goals been theirs: in the goal, or a blocked cell."""
        cell = self.cells(achieved_goal)
        event = np.where(self.world.airspace.blocked[cell], ENTERED, MOVED)  # nobody is in a blocked cell otherwise
        return self.task.end(cell, event, self.cells(desired_goal))[1]

    def truncated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Whether the cap on steps ended the flights `[...]` before the task did."""
        n_steps = _fact(info, "n_steps")
        if n_steps is None:
            raise InputError("compute_truncated: info holds no n_steps; pass the info of each step")
        return (n_steps >= self.task.max_steps) & ~self.terminated(achieved_goal, desired_goal)

    def action_mask(self, cell: Any) -> NDArray[np.int8]:
        """1 for each action that is offered in the cells `[...]`, else 0: `[..., actions]`."""
        return self.world.airspace.offered[cell].astype(np.int8)

    def check_offered(self, cell: Any, action: Any) -> None:
        """`InputError` for an action that the rule `mask` does not offer there."""
        offered = self.world.airspace.offered[cell, action]
        if not np.all(offered):
            first = int(np.asarray(action)[~offered].ravel()[0])
            name = self.world.airspace.moves.names[first]
            raise InputError(f"action {first} ({name}) is not offered here; choose one that info['action_mask'] allows")


def place_of(position: Sequence[int] | None) -> Position | None:
    """A position of plain integers, so that a message shows it as it was written."""
    if position is None:
        return None
    try:
        ix, iy, iz = (operator.index(i) for i in position)
    except (TypeError, ValueError):
        raise InputError(f"{position!r} is no position; expected three whole numbers (ix, iy, iz)") from None
    return ix, iy, iz


def _fact(info: Info | None, name: str) -> NDArray[Any] | None:
    """One fact of all steps as an array; None where it was not recorded. Some replay buffers hand over no `info` at all."""
    if info is None or any(row is None for row in info):
        return None
    if isinstance(info, Mapping):
        return np.asarray(info[name]) if name in info else None
    try:
        return np.array([row[name] for row in info])
    except KeyError:
        return None
