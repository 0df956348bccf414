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
    rows = pair_rows(sides, cell, goal)

    def one(table: Array, weight: Array, bias: Array, output: Array) -> Array:
        hidden = table[rows[0]]
        for row in rows[1:]:
            hidden = hidden + table[row]
        return jax.nn.relu(jax.nn.relu(hidden) @ weight + bias) @ output

    return jax.vmap(one)(network.table, network.weight, network.bias, network.output)
