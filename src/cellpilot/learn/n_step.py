"""Returns of n steps, computed from stored facts for the goal that is replayed."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cellpilot.learn.replay import Replay
from cellpilot.task import Task


class Return(NamedTuple):
    """What some steps brought and where they led."""

    reward: Float[Array, "..."]  # discounted sum
    terminated: Bool[Array, "..."]
    next_cell: Int[Array, "..."]
    discount: Float[Array, "..."] | None  # of the value of `next_cell`; None = that of the task, after one step


def outcome_of_steps(replay: Replay, row: Int[Array, "..."], task: Task, n_steps: int, copies: int) -> Return:
    """The outcome of up to `n_steps` steps from each row on, flown towards the row's goal.

    They end early where the task ends the flight, or where it was cut: a truncated flight is continued by its last value.
    `copies` rows were stored for each step, in the order of the flight. A step that is still stored is followed by all later
    ones of its flight, since the oldest rows give way first.
    """
    goal = replay.experiences.goal[row]
    if n_steps == 1:
        transition = jax.tree.map(lambda ring: ring[row], replay.experiences.transition)
        reward, _, terminated = task.outcome(transition, goal)
        return Return(reward, terminated, transition.next_cell, None)
    assert replay.experiences.steps_left is not None
    ahead = jnp.arange(n_steps).reshape(-1, *[1] * row.ndim)
    rows = (row + copies * ahead) % replay.capacity
    transitions = jax.tree.map(lambda ring: ring[rows], replay.experiences.transition)  # fields [n_steps, ...]
    reward, _, over = task.outcome(transitions, goal)
    over_before = jnp.cumsum(over, 0) > over
    flown = (ahead < replay.experiences.steps_left[row]) & ~over_before
    n_flown = flown.sum(0)
    last = jnp.take_along_axis(transitions.next_cell, n_flown[None] - 1, 0)[0]
    return Return(
        reward=jnp.where(flown, task.discount**ahead * reward, 0.0).sum(0),
        terminated=(flown & over).any(0),
        next_cell=last,
        discount=jnp.float32(task.discount) ** n_flown,
    )
