"""The baseline of section 4.4.1: the shortest path, without regard to the radio."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import MOVED, Moves
from cellpilot.grid import IntArray
from cellpilot.policies.base import one_hot
from cellpilot.world import World


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
        grid, airspace = self.world.grid, self.world.airspace
        steps = airspace.shortest_steps(goals)
        here = grid.position(np.arange(grid.n_cells))
        remaining = grid.position(goals)[None, :, :] - here[:, None, :]
        progress = remaining @ airspace.moves.array.T
        shorter = steps[airspace.next_cell].transpose(0, 2, 1) < steps[..., None]
        shorter &= (airspace.event == MOVED)[:, None, :]
        order = _ties(airspace.moves)
        best = np.where(shorter, progress, -np.inf)[..., order].argmax(-1)
        return one_hot(order[best].astype(np.int8), airspace.n_actions)


def _ties(moves: Moves) -> IntArray:
    """Actions in the order in which equal ones are taken: along x before y before z (see deviations), diagonals last."""
    changed = moves.array != 0
    return np.lexsort((changed.argmax(1), changed.sum(1)))
