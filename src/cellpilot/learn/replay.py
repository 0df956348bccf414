"""Replay memory: the most recent experiences as facts; reward and termination are derived when they are replayed."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from cellpilot.envs.arena import draw_integers
from cellpilot.errors import InputError
from cellpilot.task import Transition


class Experience(NamedTuple):
    """A transition and the goal it is replayed for."""

    transition: Transition
    goal: Int[Array, "..."]


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Replay:
    """A ring of experiences; `head` is where the next one goes."""

    experiences: Experience  # fields [capacity]
    head: Int[Array, ""]
    size: Int[Array, ""]

    @property
    def capacity(self) -> int:
        """Number of experiences it can hold."""
        return self.experiences.goal.shape[0]


def init_replay(capacity: int) -> Replay:
    """An empty replay memory."""

    def whole() -> Array:
        return jnp.zeros(capacity, jnp.int32)

    transition = Transition(whole(), whole(), whole(), jnp.zeros(capacity, jnp.float32), jnp.zeros(capacity, bool))
    return Replay(Experience(transition, whole()), jnp.int32(0), jnp.int32(0))


def add(replay: Replay, block: Experience, n: Int[Array, ""]) -> Replay:
    """Store the first `n` rows of `block [rows]`, the oldest experiences giving way; rows beyond `n` go nowhere."""
    capacity, rows = replay.capacity, block.goal.shape[0]
    if rows > capacity:
        raise InputError(f"replay capacity {capacity} is smaller than one flight with its hindsight goals ({rows}): raise it")
    row = jnp.arange(rows)
    place = jnp.where(row < n, (replay.head + row) % capacity, capacity)
    write = lambda ring, new: ring.at[place].set(new, mode="drop", unique_indices=False)
    experiences = jax.tree.map(write, replay.experiences, block)
    return Replay(experiences, (replay.head + n) % capacity, jnp.minimum(replay.size + n, capacity))


def sample(key: Array, replay: Replay, shape: tuple[int, ...]) -> Experience:
    """Experiences drawn uniformly with replacement, fields `[*shape]`; the memory must not be empty."""
    index = draw_integers(key, shape, replay.size)
    return jax.tree.map(lambda ring: ring[index], replay.experiences)
