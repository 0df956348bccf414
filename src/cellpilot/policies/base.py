"""What every policy offers, and how a table of values becomes one of actions."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import IntArray

TIE_TOLERANCE = 1e-9
"""Values closer than this count as equal, and the lowest action index wins; rounding alone makes equal routes differ."""


class Policy(Protocol):
    """A way to act: a pure function of cell and goal."""

    @property
    def name(self) -> str:
        """Name in tables and files."""

    @property
    def deterministic(self) -> bool:
        """Whether every row of probabilities is one-hot."""

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """Probability of each action in every cell for each goal, `[n_cells, goals, actions]`; rows sum to 1.

        Rows of blocked cells, of the goal itself and of cells that cannot reach it mean nothing.
        """


def greedy_actions(values: NDArray[np.floating], tolerance: float = TIE_TOLERANCE) -> NDArray[np.int8]:
    """Action of the highest value along the last axis, ties within `tolerance` to the lowest index."""
    return (values >= values.max(-1, keepdims=True) - tolerance).argmax(-1).astype(np.int8)


def one_hot(actions: NDArray[np.int8], n_actions: int) -> NDArray[np.float32]:
    """Probabilities `[..., n_actions]` of a deterministic policy."""
    return np.eye(n_actions, dtype=np.float32)[actions]
