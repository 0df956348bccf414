"""One flight as a goal-conditioned Gymnasium environment."""

import operator
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray

from cellpilot.envs.goal_rules import GoalRules, Info, Observation
from cellpilot.errors import InputError
from cellpilot.grid import Position
from cellpilot.task import Task, Transition
from cellpilot.world import World


class GoalEnv(gymnasium.Env[Observation, np.int64]):
    """Fly from a start to a goal; the map is known only through the SINR measured in each step.

    The observation holds the position (`observation`, and again as `achieved_goal`) and the `desired_goal`, each counted
    from 1 and divided by the side of the grid. Entering the goal terminates, and so does a blocked cell under the rule `end`;
    `task.max_steps` truncates. `info` holds the facts of the step: `cell` before it, `action`, `sinr_db` as measured, `event`
    (what became of the move, see `cellpilot.airspace`), `n_steps`, `is_success` (the goal was entered), and under the rule
    `mask` the `action_mask` of the next step, which `reset` gives as well.
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 8}  # noqa: RUF012

    def __init__(
        self,
        world: World,
        task: Task,
        *,
        start: Position | None = None,
        goal: Position | None = None,
        render_mode: str | None = None,
    ):
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode is {render_mode!r}; expected None or one of {self.metadata['render_modes']}")
        self.rules = GoalRules(world, task, start, goal)
        self.render_mode = render_mode
        self.observation_space = self.rules.observation_space  # type: ignore[assignment]
        self.action_space = self.rules.action_space
        # Lists, because one number out of an array costs several times as much.
        self._next_cell: list[list[int]] = world.airspace.next_cell.tolist()
        self._event: list[list[int]] = world.airspace.event.tolist()
        self._rows = list(self.rules.coordinates)
        self._n_actions, self._masked = world.airspace.n_actions, world.airspace.rule == "mask"
        self._error_db: NDArray[np.float32] | None = None
        self._goal = 0
        self._path: list[int] = []

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """A new pair of cells, and a new draw of what is unknown about the map.

        `options` may hold `start` or `goal`, a position `(ix, iy, iz)` each, for this flight alone.
        """
        super().reset(seed=seed)
        world = self.rules.world
        start, goal = self.rules.draw_pairs(self.np_random, 1, options)
        self._path, self._goal = [int(start[0])], int(goal[0])
        if world.signal.unknown is not None:
            self._error_db = world.signal.unknown.draw(self.np_random.standard_normal(world.grid.n_cells, np.float32))
        return self._observation(), self._mask()

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated, facts of the step."""
        if not self._path:
            raise gymnasium.error.ResetNeeded("call reset before step")
        try:
            action = operator.index(action)  # type: ignore[assignment]
        except TypeError:
            raise InputError(f"action is {action!r}; expected one whole number from 0 to {self._n_actions - 1}") from None
        if not 0 <= action < self._n_actions:
            raise InputError(f"action is {action}; expected 0 to {self._n_actions - 1}")
        cell, task, signal = self._path[-1], self.rules.task, self.rules.world.signal
        if self._masked:
            self.rules.check_offered(cell, action)
        next_cell, event = self._next_cell[cell][action], self._event[cell][action]
        error_db = None if self._error_db is None else self._error_db[next_cell]
        noise = self.np_random.standard_normal(dtype=np.float32) if signal.noise_std_db else None
        sinr_db = signal.measure(next_cell, error_db, noise)
        self._path.append(next_cell)
        n_steps = len(self._path) - 1
        reward, reached, terminated = task.outcome(Transition(cell, action, next_cell, sinr_db, event), self._goal)
        info = {"cell": cell, "action": action, "sinr_db": float(sinr_db), "event": event, "n_steps": n_steps}
        info |= {"is_success": reached} | self._mask()
        return self._observation(), float(reward), terminated, n_steps >= task.max_steps and not terminated, info

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Rewards `[...]` of steps that led to the achieved goals `[..., dims]`, had the desired ones been the goals.

        `info` is that of the step, or a sequence of one per row. Without facts in it the map is looked up, if the cell
        alone decides the reward; else `InputError`.
        """
        return self.rules.reward(achieved_goal, desired_goal, info)

    def compute_terminated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Whether the flights end in these steps, had the desired goals been theirs, `[...]`."""
        return self.rules.terminated(achieved_goal, desired_goal)

    def compute_truncated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Whether the cap on steps ended the flights before the desired goals were entered, `[...]`."""
        return self.rules.truncated(achieved_goal, desired_goal, info)

    def render(self) -> NDArray[np.uint8] | None:
        """The map at the height flown, the flight so far and the goal, as RGB `[height, width, 3]`; None without render mode."""
        if self.render_mode is None:
            return None
        if not self._path:
            raise gymnasium.error.ResetNeeded("call reset before render")
        from cellpilot.envs.picture import draw_flight

        return draw_flight(self.rules.world, self.rules.task, self._path, self._goal)

    def _mask(self) -> dict[str, Any]:
        return {"action_mask": self.rules.action_mask(self._path[-1])} if self._masked else {}

    def _observation(self) -> Observation:
        here = self._rows[self._path[-1]]
        return {"observation": here.copy(), "achieved_goal": here.copy(), "desired_goal": self._rows[self._goal].copy()}
