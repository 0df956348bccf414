"""The random policy: every action with the same probability, for comparison in Python."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import IntArray
from cellpilot.world import World


@dataclass(frozen=True)
class RandomPolicy:
    """Uniform over the actions."""

    world: World
    name: str = "random"
    deterministic: bool = False

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """Constant rows `[n_cells, goals, actions]`."""
        grid = self.world.grid
        return np.full((grid.n_cells, len(goals), grid.n_actions), 1.0 / grid.n_actions, dtype=np.float32)
