"""The exact optimum as a policy: solved for the goals asked for, once each."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import IntArray
from cellpilot.policies.base import greedy_actions, one_hot
from cellpilot.solve import goals_solved_at_once, optimal_values
from cellpilot.task import Task
from cellpilot.world import World


@dataclass(frozen=True)
class OptimalPolicy:
    """Maximises the expected return at the task's discount (or at `discount`); ties to the lowest action index."""

    world: World
    task: Task
    discount: float | None = None
    name: str = "optimal"
    deterministic: bool = True
    _actions: dict[int, NDArray[np.int8]] = field(default_factory=dict, repr=False, compare=False)

    @classmethod
    def undiscounted(cls, world: World, task: Task) -> "OptimalPolicy":
        """The optimum for discount 1, the measure by which every policy is scored."""
        return cls(world, task, 1.0, "optimal-undiscounted")

    def actions(self, goals: IntArray) -> NDArray[np.int8]:
        """Best action of every cell for each goal, `[n_cells, goals]`; solved once per goal."""
        missing = np.array([g for g in np.unique(goals) if int(g) not in self._actions], dtype=np.int32)
        at_once = goals_solved_at_once(self.world)
        for i in range(0, len(missing), at_once):
            block = missing[i : i + at_once]
            best = greedy_actions(np.nan_to_num(optimal_values(self.world, self.task, block, self.discount), neginf=-1e18))
            self._actions.update({int(goal): best[:, k].copy() for k, goal in enumerate(block)})
        return np.stack([self._actions[int(g)] for g in goals], axis=1)

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """One-hot rows `[n_cells, goals, actions]`."""
        return one_hot(self.actions(goals), self.world.airspace.n_actions)
