"""What a learner offers to the trainer, however it computes: one protocol for compiled and for plain Python learners."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

from cellpilot.grid import Position
from cellpilot.policies.learned import PolicyParameters
from cellpilot.task import Task
from cellpilot.world import World

History = dict[str, NDArray[Any]]
"""Columns of a learning curve, `[rounds]` each: episode_return, n_steps, reached, and others of the algorithm's own."""


@dataclass(frozen=True)
class Place:
    """Where a learner flies and for what: random pairs of free cells, unless a start or a goal is given."""

    world: World
    task: Task
    start: Position | None = None
    goal: Position | None = None


@runtime_checkable
class Program(Protocol):
    """Rounds of training for some seeds at once; their states travel as one, which `pack` makes and `unpack` opens."""

    def pack(self, states: Sequence[Any]) -> Any:
        """The states of all seeds as the program takes them."""

    def unpack(self, packed: Any) -> list[Any]:
        """The state of each seed, to be saved or to go on in another program."""

    def run(self, packed: Any, n_rounds: int) -> tuple[Any, list[History]]:
        """The packed states after `n_rounds` more rounds (the old ones are gone), and each seed's rows of the learning curve."""


@runtime_checkable
class Learner(Protocol):
    """One algorithm with its settings at one place; randomness is a function of (seed, round) alone.

    A state is a tree of arrays, as `jax.tree` walks them: everything that training changes, so that a checkpoint of it is all
    that resuming needs. Neither chunks nor interruptions change a result.
    """

    def initial_state(self, seed: int) -> Any:
        """The state before anything is learned."""

    def preparation(self, state: Any) -> Callable[[Any, int], Any] | None:
        """What is done once before the first round, (state, seed) -> state; None for nothing."""

    def program(self, states: Sequence[Any], seeds: Sequence[int], length: int) -> Program:
        """Rounds of training, up to `length` at a time, for these seeds."""

    @property
    def no_history(self) -> History:
        """The learning curve before the first round: its columns, each of length 0."""

    def exploration_at(self, round_: NDArray[np.int64]) -> NDArray[np.float32]:
        """How much each round explores, in the quantity that the settings' `explores_by` names."""

    def learned(self, state: Any) -> Any:
        """What flies, of a state or of packed ones: arrays. Training has diverged if they are not finite."""

    def env_steps(self, state: Any) -> int:
        """Steps flown, random ones included."""

    def policy_parameters(self, state: Any, about: dict[str, Any]) -> PolicyParameters:
        """What was learned as plain NumPy arrays that fly without JAX; `about` describes the training, and has the task."""
