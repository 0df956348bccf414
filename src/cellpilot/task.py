"""`Task`: the reward of equation 4.4 with all its parameters, for the environment, the learner and the optimum.

`outcome` derives reward and termination from facts, so a hindsight goal is nothing but another goal;
`expected_outcome` is its expectation over the noise. Both use arithmetic that NumPy and traced arrays share.
"""

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.world import World


class Transition(NamedTuple):
    """Facts of one step; every field has the same shape."""

    cell: Any  # int, before the step
    action: Any  # int
    next_cell: Any  # int, after the step
    sinr_db: Any  # float, as measured in `next_cell`, noise included
    blocked: Any  # bool, a blocked cell stopped the move


class Moves(Protocol):
    """Where actions lead, `[cells, actions]`: what a `World` and an `Arena` have in common."""

    @property
    def next_cell(self) -> Any:
        """Cell after each action."""

    @property
    def stopped(self) -> Any:
        """Whether a blocked cell stops the action."""


@dataclass(frozen=True)
class Task:
    """Rewards (Table 4.2), SINR threshold, discount (Table 4.3) and the cap on steps of one flight."""

    rho_goal: float = 10.0
    rho_sinr: float = -1.0
    rho_step: float = -0.1
    rho_blocked: float = 0.0
    threshold_db: float = 3.0
    discount: float = 0.995
    max_steps: int = 400

    def __post_init__(self) -> None:
        if not 0 < self.discount <= 1:
            raise InputError(f"discount is {self.discount:g}; expected 0 < discount <= 1")
        if self.max_steps < 1:
            raise InputError(f"max_steps is {self.max_steps}; expected at least 1")

    @property
    def value_bounds(self) -> tuple[float, float]:
        """Least and greatest discounted return that any flight, however long, can have; infinite without discount."""
        step = (self.rho_step, self.rho_step + self.rho_sinr, self.rho_step + self.rho_blocked)
        worst, best = min(0.0, *step, step[1] + self.rho_blocked), max(0.0, *step, step[1] + self.rho_blocked)
        horizon = np.inf if self.discount == 1 else 1 / (1 - self.discount)
        least = worst * horizon if worst else 0.0
        greatest = best * horizon if best else 0.0
        return least + min(0.0, self.rho_goal), greatest + max(0.0, self.rho_goal)

    def outcome(self, transition: Transition, goal: Any) -> tuple[Any, Any]:
        """Reward and whether the flight terminated, for each transition flown towards `goal` (equation 4.4)."""
        terminated = transition.next_cell == goal
        low = transition.sinr_db < self.threshold_db
        reward = self.rho_step + self.rho_goal * terminated + self.rho_sinr * low + self.rho_blocked * transition.blocked
        return reward, terminated

    def expected_outcome(
        self, world: "World | Moves", cell: Any, action: Any, goal: Any, low_probability: Any = None
    ) -> tuple[Any, Any]:
        """`outcome` in expectation over noise and map uncertainty, from the world instead of a measurement.

        Where `low_probability [cells]` is given, nothing but the moves is read of the world.
        """
        if low_probability is None:
            assert isinstance(world, World)
            low_probability = world.low_probability(self.threshold_db)
        low = low_probability
        next_cell = world.next_cell[cell, action]
        terminated = next_cell == goal
        reward = (
            self.rho_step
            + self.rho_goal * terminated
            + self.rho_sinr * low[next_cell]
            + self.rho_blocked * world.stopped[cell, action]
        )
        return reward, terminated


def default_max_steps(grid: Grid) -> int:
    """Ten times the sum of the sides: 400 for 20 x 20, 450 for 20 x 20 x 5 (section 4.2.2)."""
    return 10 * sum(n for n in grid.sides if n > 1)
