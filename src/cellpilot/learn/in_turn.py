"""Learners in plain Python: one flight after another, each seed by itself. A new one needs a class with four methods.

`examples/q_learning.py` is a complete one.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
from numpy.typing import NDArray

from cellpilot.learn.learner import History
from cellpilot.policies.learned import PolicyParameters

Arrays = dict[str, NDArray[Any]]


class FlightRow(NamedTuple):
    """One flight in the learning curve."""

    episode_return: float  # undiscounted
    n_steps: int
    reached: bool


@runtime_checkable
class OneSeed(Protocol):
    """What one seed has learned so far."""

    def fly(self, number: int) -> FlightRow:
        """Fly flight `number` (from 0), learn from it; randomness is a function of seed and number alone."""

    def arrays(self) -> Arrays:
        """Everything that flying changes, by name; settings and place alone decide names, shapes and types."""

    def restore(self, arrays: Arrays) -> None:
        """Become what had these arrays: later flights are then equal bit for bit."""

    def policy_parameters(self, about: dict[str, Any]) -> PolicyParameters:
        """What was learned as arrays that fly without this class."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class InTurnState:
    """The arrays of a learner, and how far it is."""

    arrays: Arrays
    rounds_done: NDArray[np.int64]  # a single number
    env_steps: NDArray[np.int64]  # a single number


@dataclass
class _Flying:
    """A learner in the air."""

    learner: OneSeed
    rounds_done: int
    env_steps: int


@dataclass(frozen=True)
class InTurn:
    """`learn.learner.Learner` of plain Python: `begin(seed)` makes the learner of a seed, which has learned nothing."""

    begin: Callable[[int], OneSeed]
    exploration: Callable[[NDArray[np.int64]], NDArray[Any]]  # rounds -> how much each explores

    def initial_state(self, seed: int) -> InTurnState:
        """Before anything is learned."""
        return _state(_Flying(self.begin(seed), 0, 0))

    def preparation(self, state: Any) -> None:
        """Nothing."""

    def program(self, states: Sequence[InTurnState], seeds: Sequence[int], length: int) -> "_InTurnProgram":
        """Flights of these seeds, one seed after another."""
        return _InTurnProgram(self, seeds)

    @property
    def no_history(self) -> History:
        """The columns of `FlightRow`."""
        return _history([])

    def exploration_at(self, round_: NDArray[np.int64]) -> NDArray[np.float32]:
        """How much each flight explores."""
        return np.broadcast_to(np.asarray(self.exploration(round_), np.float32), np.shape(round_))

    def learned(self, state: Any) -> list[NDArray[np.floating]]:
        """All real numbers that were learned."""
        found = [state.arrays] if isinstance(state, InTurnState) else [flying.learner.arrays() for flying in state]
        return [array for arrays in found for array in arrays.values() if np.issubdtype(array.dtype, np.floating)]

    def env_steps(self, state: InTurnState) -> int:
        """Steps flown."""
        return int(state.env_steps)

    def policy_parameters(self, state: InTurnState, about: dict[str, Any]) -> PolicyParameters:
        """What was learned."""
        learner = self.begin(about.get("seed", 0))
        learner.restore(state.arrays)
        return learner.policy_parameters(about)


@dataclass(frozen=True)
class _InTurnProgram:
    algorithm: InTurn
    seeds: Sequence[int]

    def pack(self, states: Sequence[InTurnState]) -> list[_Flying]:
        """Learners that go on from the states."""
        flying = [
            _Flying(self.algorithm.begin(seed), int(state.rounds_done), int(state.env_steps))
            for seed, state in zip(self.seeds, states, strict=True)
        ]
        for one, state in zip(flying, states, strict=True):
            one.learner.restore(state.arrays)
        return flying

    def unpack(self, packed: list[_Flying]) -> list[InTurnState]:
        """The state of each."""
        return [_state(flying) for flying in packed]

    def run(self, packed: list[_Flying], n_rounds: int) -> tuple[list[_Flying], list[History]]:
        """`n_rounds` more flights of every seed."""
        curves = []
        for flying in packed:
            rows = [flying.learner.fly(flying.rounds_done + i) for i in range(n_rounds)]
            flying.rounds_done += n_rounds
            flying.env_steps += sum(row.n_steps for row in rows)
            curves.append(_history(rows))
        return packed, curves


def _state(flying: _Flying) -> InTurnState:
    arrays = {name: np.array(array) for name, array in flying.learner.arrays().items()}
    return InTurnState(arrays, np.array(flying.rounds_done), np.array(flying.env_steps))


def _history(rows: Sequence[FlightRow]) -> History:
    types = {"episode_return": np.float32, "n_steps": np.int32, "reached": np.bool_}
    return {name: np.array([getattr(row, name) for row in rows], dtype) for name, dtype in types.items()}
