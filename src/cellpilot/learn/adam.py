"""Adam (Kingma and Ba 2015) with its default constants, in the efficient form of its section 2: one division per parameter."""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

BETA_1, BETA_2, EPSILON = 0.9, 0.999, 1e-8


class AdamState(NamedTuple):
    """Moments of the gradient, each a tree like that of the parameters."""

    mu: Any
    nu: Any
    n_steps: Int[Array, ""]


def init_adam(parameters: Any) -> AdamState:
    """No moments yet."""
    return AdamState(jax.tree.map(jnp.zeros_like, parameters), jax.tree.map(jnp.zeros_like, parameters), jnp.int32(0))


def adam_step(parameters: Any, gradient: Any, state: AdamState, learning_rate: float | Array) -> tuple[Any, AdamState]:
    """Parameters and state after one step: the same step as Algorithm 1, its two corrections of the start merged."""
    n_steps = state.n_steps + 1
    mu = jax.tree.map(lambda m, g: BETA_1 * m + (1 - BETA_1) * g, state.mu, gradient)
    nu = jax.tree.map(lambda v, g: BETA_2 * v + (1 - BETA_2) * g * g, state.nu, gradient)
    root = jnp.sqrt(1 - BETA_2**n_steps)
    length = learning_rate * root / (1 - BETA_1**n_steps)
    step = lambda p, m, v: p - length * m / (jnp.sqrt(v) + EPSILON * root)
    return jax.tree.map(step, parameters, mu, nu), AdamState(mu, nu, n_steps)
