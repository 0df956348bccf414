"""The random policy: every action with the same probability, for comparison in Python."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import IntArray
from cellpilot.world import World


@dataclass(frozen=True)
class RandomPolicy:
    """Uniform over the actions that are offered."""

    world: World
    name: str = "random"
    deterministic: bool = False

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """Rows `[n_cells, goals, actions]`, the same for every goal; over all actions in a cell that offers none."""
        offered = self.world.airspace.offered
        offered = (offered | ~offered.any(1, keepdims=True)).astype(np.float32)
        return np.repeat((offered / offered.sum(1, keepdims=True))[:, None, :], len(goals), axis=1)
