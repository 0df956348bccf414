"""Exploration as noise on the action values: the action taken is the arg max of Q + noise.

Adding temperature x Gumbel noise and taking the arg max draws from the Boltzmann distribution (equation 3.15) exactly;
noise larger than any value on a share epsilon of the steps is epsilon-greedy. Drawn for a whole flight at once.
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def linear_schedule(initial: float, final: float, fraction: float, progress: Float[Array, "..."]) -> Float[Array, "..."]:
    """From `initial` to `final` over the first `fraction` of the episodes, then constant; `progress` in [0, 1]."""
    return initial + (final - initial) * jnp.minimum(progress / fraction, 1.0)


def boltzmann_noise(key: Array, temperature: Float[Array, ""], shape: tuple[int, ...]) -> Float[Array, "steps actions"]:
    """Temperature x standard Gumbel noise (section 3.1.6)."""
    return temperature * jax.random.gumbel(key, shape)


def epsilon_greedy_noise(key: Array, epsilon: Float[Array, ""], shape: tuple[int, int]) -> Float[Array, "steps actions"]:
    """Zero, or on a share `epsilon` of the steps noise that drowns every value: a uniformly random action."""
    key_when, key_what = jax.random.split(key)
    random_step = jax.random.uniform(key_when, (shape[0], 1)) < epsilon
    return jnp.where(random_step, 1e6 * jax.random.uniform(key_what, shape), 0.0)


NOISE = {"boltzmann": boltzmann_noise, "epsilon-greedy": epsilon_greedy_noise}
