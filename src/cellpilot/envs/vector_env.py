"""Many flights at once as a Gymnasium vector environment: every step is a handful of NumPy operations over all flights."""

from typing import Any

import numpy as np
from gymnasium.error import ResetNeeded
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from cellpilot.envs.goal_rules import GoalRules, Info, Observation
from cellpilot.errors import InputError
from cellpilot.grid import IntArray, Position
from cellpilot.task import Task, Transition
from cellpilot.world import World

Flags = NDArray[np.bool_]


class GoalVectorEnv(VectorEnv[Observation, IntArray, NDArray[Any]]):
    """`num_envs` flights of `GoalEnv`, stepped together; one random generator serves them all.

    `autoreset_mode` is Gymnasium's: a flight that has ended begins anew with the next step (`NEXT_STEP`; that step's action
    is ignored), within the same one (`SAME_STEP`; the last observation is in `info["final_obs"]`), or when `reset` is called
    with `options={"reset_mask": ...}` (`DISABLED`).
    """

    metadata = {"render_modes": [], "autoreset_mode": AutoresetMode.NEXT_STEP}  # noqa: RUF012

    def __init__(
        self,
        world: World,
        task: Task,
        num_envs: int = 1,
        *,
        start: Position | None = None,
        goal: Position | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
    ):
        if num_envs < 1:
            raise InputError(f"num_envs is {num_envs}; expected at least 1")
        if render_mode is not None:
            raise InputError(f"render_mode is {render_mode!r}, but many flights are not drawn: draw one, with gymnasium.make")
        try:
            self.autoreset_mode = AutoresetMode(autoreset_mode)
        except ValueError:
            modes = ", ".join(mode.value for mode in AutoresetMode)
            raise InputError(f"autoreset_mode is {autoreset_mode!r}; expected one of {modes}") from None
        self.rules = GoalRules(world, task, start, goal)
        self.num_envs, self.render_mode = num_envs, render_mode
        self.metadata = {**self.metadata, "autoreset_mode": self.autoreset_mode}
        self.single_observation_space, self.single_action_space = self.rules.observation_space, self.rules.action_space
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._cell, self._goal, self._n_steps = (np.zeros(num_envs, np.int32) for _ in range(3))
        self._begun = False
        self._over = np.ones(num_envs, bool)  # ended, and not begun anew
        self._masked = world.airspace.rule == "mask"
        self._error_db = None if world.signal.unknown is None else np.zeros((num_envs, world.grid.n_cells), np.float32)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """New pairs for all flights, or for those that `options["reset_mask"]` (bool `[num_envs]`) names.

        `options` may also hold `start` or `goal`, a position `(ix, iy, iz)` each.
        """
        super().reset(seed=seed)
        options = dict(options or {})
        which = np.asarray(options.pop("reset_mask", np.ones(self.num_envs, bool)))
        if which.shape != (self.num_envs,) or which.dtype != np.bool_:
            raise InputError(f"reset_mask has shape {which.shape} of {which.dtype}; expected ({self.num_envs},) of bool")
        self._begin(which, options)
        self._begun = True
        return self.rules.observation(self._cell, self._goal), self._mask()

    def step(self, actions: IntArray) -> tuple[Observation, NDArray[np.float64], Flags, Flags, dict[str, Any]]:
        """Observations, rewards, terminated, truncated and facts of the step, each over the flights."""
        if not self._begun:
            raise ResetNeeded("call reset before step")
        actions = self._checked(actions)
        skip = self._over.copy() if self.autoreset_mode is AutoresetMode.NEXT_STEP else np.zeros(self.num_envs, bool)
        if self._over.any() and not skip.any():
            raise InputError("a flight has ended: call reset with options={'reset_mask': terminated | truncated} first")
        world, task = self.rules.world, self.rules.task
        if self._masked:
            self.rules.check_offered(self._cell[~skip], actions[~skip])
        before, next_cell = self._cell, world.airspace.next_cell[self._cell, actions]
        event = world.airspace.event[self._cell, actions]
        sinr_db = self._measured(next_cell)
        reward, reached, terminated = task.outcome(Transition(before, actions, next_cell, sinr_db, event), self._goal)
        self._cell, self._n_steps = next_cell, self._n_steps + 1
        truncated = (self._n_steps >= task.max_steps) & ~terminated
        if skip.any():
            self._begin(skip)
            reward, terminated, truncated = np.where(skip, 0.0, reward), terminated & ~skip, truncated & ~skip
        facts = {"cell": before, "action": actions, "sinr_db": sinr_db, "event": event, "n_steps": self._n_steps.copy()}
        facts["is_success"] = reached & ~skip
        info = _with_masks(facts, ~skip)
        self._over = terminated | truncated
        if self.autoreset_mode is AutoresetMode.SAME_STEP and self._over.any():
            info |= self._final(facts, self._over)
            self._begin(self._over)
        return self.rules.observation(self._cell, self._goal), reward, terminated, truncated, info | self._mask()

    def compute_reward(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """As `GoalEnv.compute_reward`; takes the `info` of this environment's `step` as it is."""
        return self.rules.reward(achieved_goal, desired_goal, info)

    def compute_terminated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Whether the flights end in these steps, had the desired goals been theirs, `[...]`."""
        return self.rules.terminated(achieved_goal, desired_goal)

    def compute_truncated(self, achieved_goal: NDArray[Any], desired_goal: NDArray[Any], info: Info) -> Any:
        """Whether the cap on steps ended the flights before the desired goals were entered, `[...]`."""
        return self.rules.truncated(achieved_goal, desired_goal, info)

    def _begin(self, which: Flags, options: dict[str, Any] | None = None) -> None:
        """New flights where `which` says so; all arrays are new, those handed out before stay as they were."""
        n = int(which.sum())
        self._cell, self._goal, self._n_steps = self._cell.copy(), self._goal.copy(), self._n_steps.copy()
        self._cell[which], self._goal[which] = self.rules.draw_pairs(self.np_random, n, options)
        self._n_steps[which] = 0
        self._over = self._over & ~which
        unknown = self.rules.world.signal.unknown
        if self._error_db is not None and unknown is not None:
            normal = self.np_random.standard_normal((n, self.rules.world.grid.n_cells), np.float32)
            self._error_db[which] = unknown.draw(normal)

    def _mask(self) -> dict[str, Any]:
        return _with_masks({"action_mask": self.rules.action_mask(self._cell)}, ~self._over) if self._masked else {}

    def _measured(self, cells: IntArray) -> NDArray[np.float32]:
        signal = self.rules.world.signal
        error_db = None if self._error_db is None else self._error_db[np.arange(self.num_envs), cells]
        noise = self.np_random.standard_normal(self.num_envs, np.float32) if signal.noise_std_db else None
        return signal.measure(cells, error_db, noise)

    def _checked(self, actions: IntArray) -> IntArray:
        actions, n_actions = np.asarray(actions), self.rules.world.airspace.n_actions
        if actions.shape != (self.num_envs,) or not np.issubdtype(actions.dtype, np.integer):
            raise InputError(f"actions have shape {actions.shape} of {actions.dtype}; expected ({self.num_envs},) of integers")
        if ((actions < 0) | (actions >= n_actions)).any():
            raise InputError(f"actions are {actions.min()} to {actions.max()}; expected 0 to {n_actions - 1}")
        return actions

    def _final(self, facts: dict[str, NDArray[Any]], over: Flags) -> dict[str, Any]:
        """What Gymnasium expects of an environment that begins anew within the step: the observations and facts at the end."""
        observations = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(over):
            observations[i] = self.rules.observation(self._cell[i], self._goal[i])
        final = {name: np.where(over, values, np.zeros((), values.dtype)) for name, values in facts.items()}
        return _with_masks({"final_obs": observations, "final_info": _with_masks(final, over)}, over)


def _with_masks(facts: dict[str, Any], valid: Flags) -> dict[str, Any]:
    """The facts, and beside each the mask of the flights it holds for, as Gymnasium's vector environments give them."""
    return facts | {f"_{name}": valid.copy() for name in facts}
