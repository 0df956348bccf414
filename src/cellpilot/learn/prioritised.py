"""Prioritised replay (Schaul et al. 2016), the proportional variant: draws in proportion to priorities, and their correction.

A priority here is already raised to its exponent, so that chances are proportional to it; 0 = nothing stored there yet.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

FAN = 16
"""Rows that one sum stands for. 500,000 rows have 31,250 sums, these have 1,954, and so on: five draws lead to a row."""

SMALLEST_ERROR = 1e-6
"""Added to errors, so that nothing is never replayed again."""


def draw_in_proportion(
    key: Array, priority: Float[Array, " capacity"], size: Int[Array, ""], shape: tuple[int, ...]
) -> Int[Array, "..."]:
    """Rows drawn with replacement, each with chance priority / sum of priorities, `[*shape]`.

    The tree of sums is made anew from all priorities, which are at work for all draws of an episode, and every level is drawn
    with its own random number: one number for all of them has too few digits for rows of small priority.
    """
    levels = [priority]
    while levels[-1].size > FAN:
        levels.append(_sums_of_groups(levels[-1]))
    running_sum = jnp.triu(jnp.ones((FAN, FAN)))  # a third faster than `cumsum`
    row = jnp.zeros(shape, jnp.int32)
    for level, key_level in zip(reversed(levels), jax.random.split(key, len(levels)), strict=True):
        children = FAN * row[..., None] + jnp.arange(FAN)
        ends = jnp.matmul(level.at[children].get(mode="fill", fill_value=0.0), running_sum, precision="highest")
        point = jax.random.uniform(key_level, (*shape, 1)) * ends[..., -1:]
        row = FAN * row + (ends <= point).sum(-1)
    return jnp.minimum(row, size - 1)  # rounding can lead past the last stored row


def importance_weights(
    priority: Float[Array, " capacity"], row: Int[Array, "... batch"], size: Int[Array, ""], exponent: Float[Array, ""]
) -> Float[Array, "... batch"]:
    """(N P(row))^-exponent, divided by the greatest of its mini-batch: 1 undoes the preference for large errors, 0 nothing."""
    weight = (size * priority[row] / priority.sum()) ** -exponent
    return weight / weight.max(-1, keepdims=True)


def renew_priorities(
    priority: Float[Array, " capacity"], row: Int[Array, "..."], error: Float[Array, "..."], exponent: float
) -> Float[Array, " capacity"]:
    """Priorities after the drawn rows got new errors; for a row drawn more than once the greatest error counts."""
    return priority.at[row].set(0.0).at[row].max((jnp.abs(error) + SMALLEST_ERROR) ** exponent)


def priority_of_new(priority: Float[Array, " capacity"]) -> Float[Array, ""]:
    """The greatest priority there is, so that everything new is replayed soon; 1 in an empty memory."""
    greatest = priority.max()
    return jnp.where(greatest > 0, greatest, 1.0)


def _sums_of_groups(x: Float[Array, " n"]) -> Float[Array, " groups"]:
    return jnp.pad(x, (0, -x.size % FAN)).reshape(-1, FAN).sum(1)
