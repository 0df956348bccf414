"""All streams of random numbers by name: one integer from a person, a purpose from here, and an index where there are many.

Two purposes of one enumeration never share a stream of a seed. The numbers are part of what a seed means: a new purpose takes
a new number.
"""

from enum import IntEnum
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Array


class Learning(IntEnum):
    """Of a compiled learner, in the keys of JAX."""

    INITIAL_STATE = 0
    REPLAY_START = 1  # random flights that fill the replay memory
    ROUNDS = 2  # index: round
    GOING_ON = 3  # rounds on another network; index: round


class Flying(IntEnum):
    """Of a learner in plain Python, flight by flight; index: flight."""

    PAIR = 1  # start and goal
    NOISE = 2  # of the measurements
    CHOICES = 3  # of the learner
    MAP = 4  # what is unknown of the map, drawn once


class Evaluating(IntEnum):
    """Of an evaluation."""

    INSTANCES = 0
    FLIGHTS = 1
    EXHAUSTIVE = 2  # maps drawn for the exact figures


def stream(seed: int, purpose: IntEnum, index: int | None = None) -> np.random.Generator:
    """The generator of a purpose, and of an index within it."""
    return np.random.default_rng([seed, int(purpose)] if index is None else [seed, int(purpose), index])


def learning_key(seed: Any, purpose: Learning) -> "Array":
    """The key of a purpose; `seed` may be traced."""
    import jax

    return jax.random.fold_in(jax.random.key(seed), int(purpose))
