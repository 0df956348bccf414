"""The baseline of section 4.4.1: the shortest path, without regard to the radio."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import MOVES, IntArray
from cellpilot.policies.base import one_hot
from cellpilot.world import World

AXES_FIRST = np.array([2, 3, 0, 1, 4, 5])
"""Actions in the order in which equally long remaining axes are served: x before y before z (see deviations)."""


@dataclass(frozen=True)
class GreedyPolicy:
    """Of the moves that shorten the allowed path, the one along the longest remaining axis; ties x before y before z.

    With nothing blocked this is the thesis's baseline; around blocked cells it is a shortest allowed path.
    """

    world: World
    name: str = "greedy"
    deterministic: bool = True

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """One-hot rows `[n_cells, goals, actions]`."""
        grid = self.world.grid
        steps = self.world.shortest_steps(goals)
        here = grid.position(np.arange(grid.n_cells))
        remaining = grid.position(goals)[None, :, :] - here[:, None, :]
        progress = remaining @ MOVES[: grid.n_actions].T
        shorter = steps[self.world.next_cell].transpose(0, 2, 1) < steps[..., None]
        order = AXES_FIRST[: grid.n_actions]
        best = np.where(shorter, progress, -np.inf)[..., order].argmax(-1)
        return one_hot(order[best].astype(np.int8), grid.n_actions)
