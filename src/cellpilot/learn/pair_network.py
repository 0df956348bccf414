"""The trainable side of `policies/pair_value.py`: parameters of the value network over pairs of cells."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cellpilot.policies.pair_value import Sides, n_rows, pair_rows

SMALL = 0.1
"""Standard deviation of the first values in the table and the output: small, so that training starts at no correction."""


class PairNetwork(eqx.Module):
    """`networks` independent networks side by side; the least of their corrections counts (clipped double Q-learning)."""

    table: Float[Array, "networks rows hidden"]
    weight: Float[Array, "networks hidden hidden"]
    bias: Float[Array, "networks hidden"]
    output: Float[Array, "networks hidden"]

    def __init__(self, sides: Sides, hidden: int, networks: int, key: Array):
        keys = jax.random.split(key, 3)
        self.table = SMALL * jax.random.normal(keys[0], (networks, n_rows(sides), hidden))
        self.weight = jax.random.normal(keys[1], (networks, hidden, hidden)) * jnp.sqrt(2 / hidden)
        self.bias = jnp.zeros((networks, hidden))
        self.output = SMALL * jax.random.normal(keys[2], (networks, hidden)) / jnp.sqrt(hidden)


def corrections(
    network: PairNetwork, sides: Sides, cell: Int[Array, "..."], goal: Int[Array, "..."]
) -> Float[Array, "networks ..."]:
    """What each network adds to the bound of each pair; `cell` and `goal` broadcast against each other."""
    cell, goal = jnp.broadcast_arrays(cell, goal)
    rows = tuple(pair_rows(sides, cell, goal))

    def one(table: Array, weight: Array, bias: Array, output: Array) -> Array:
        return jax.nn.relu(jax.nn.relu(sum_of_rows(table, rows)) @ weight + bias) @ output

    return jax.vmap(one)(network.table, network.weight, network.bias, network.output)


@jax.custom_vjp
def sum_of_rows(table: Float[Array, "rows hidden"], rows: tuple[Int[Array, "..."], ...]) -> Float[Array, "... hidden"]:
    """The sum of some rows of the table for each pair.

    Its gradient adds to one array in turn; derived automatically it would be an array as large as the table for each of
    `rows`, and their sum.
    """
    total = table[rows[0]]
    for row in rows[1:]:
        total = total + table[row]
    return total


def _sum_forward(table: Array, rows: tuple[Array, ...]) -> tuple[Array, tuple[Array, tuple[Array, ...]]]:
    return sum_of_rows(table, rows), (table, rows)


def _sum_backward(saved: tuple[Array, tuple[Array, ...]], gradient: Array) -> tuple[Array, None]:
    table, rows = saved
    total = jnp.zeros_like(table)
    for row in rows:
        total = total.at[row].add(gradient)
    return total, None


sum_of_rows.defvjp(_sum_forward, _sum_backward)
