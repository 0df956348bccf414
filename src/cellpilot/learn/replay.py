"""Replay memory: the most recent experiences as facts; reward and termination are derived when they are replayed."""

from dataclasses import dataclass
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import draw_integers
from cellpilot.errors import InputError
from cellpilot.learn.prioritised import draw_in_proportion, priority_of_new
from cellpilot.task import Transition


class Experience(NamedTuple):
    """A transition and the goal it is replayed for."""

    transition: Transition
    goal: Int[Array, "..."]
    steps_left: Int[Array, "..."] | None = None  # of its flight, this one included; only kept for returns of several steps


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Replay:
    """A ring of experiences; `head` is where the next one goes."""

    experiences: Experience  # fields [capacity]
    head: Int[Array, ""]
    size: Int[Array, ""]
    priority: Float[Array, " capacity"] | None = None  # of prioritised replay; 0 where nothing is stored

    @property
    def capacity(self) -> int:
        """Number of experiences it can hold."""
        return self.experiences.goal.shape[0]


def init_replay(capacity: int, with_steps_left: bool = False, prioritised: bool = False) -> Replay:
    """An empty replay memory; the last two are what is kept besides."""

    def whole() -> Array:
        return jnp.zeros(capacity, jnp.int32)

    transition = Transition(whole(), whole(), whole(), jnp.zeros(capacity, jnp.float32), jnp.zeros(capacity, jnp.uint8))
    experiences = Experience(transition, whole(), whole() if with_steps_left else None)
    priority = jnp.zeros(capacity, jnp.float32) if prioritised else None
    return Replay(experiences, jnp.int32(0), jnp.int32(0), priority)


def add(replay: Replay, block: Experience, n: Int[Array, ""]) -> Replay:
    """Store the first `n` rows of `block [rows]`, the oldest experiences giving way; rows beyond `n` go nowhere."""
    capacity, rows = replay.capacity, block.goal.shape[0]
    if rows > capacity:
        raise InputError(f"replay capacity {capacity} is smaller than one flight with its hindsight goals ({rows}): raise it")
    row = jnp.arange(rows)
    place = jnp.where(row < n, (replay.head + row) % capacity, capacity)
    write = lambda ring, new: ring.at[place].set(new, mode="drop", unique_indices=False)
    experiences = jax.tree.map(write, replay.experiences, block)
    priority = replay.priority
    if priority is not None:
        priority = write(priority, priority_of_new(priority))
    return Replay(experiences, (replay.head + n) % capacity, jnp.minimum(replay.size + n, capacity), priority)


def draw_rows(key: Array, replay: Replay, shape: tuple[int, ...]) -> Int[Array, "..."]:
    """Rows drawn with replacement, uniformly or by priority, `[*shape]`; the memory must not be empty."""
    if replay.priority is None:
        return draw_integers(key, shape, replay.size)
    return draw_in_proportion(key, replay.priority, replay.size, shape)
