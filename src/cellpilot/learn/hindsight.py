"""Hindsight goals (section 3.3.4): cells a flight did reach, to be stored as if they had been its goal."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Int

from cellpilot.envs.flight import Flight
from cellpilot.learn.algorithms.ddqn_her_settings import Strategy


def hindsight_goals(key: Array, flight: Flight, k: int, strategy: Strategy, ends: bool = False) -> Int[Array, "steps k"]:
    """`k` goals for each step: cells entered later in the flight, in its last step, or in any of its steps.

    `future` draws t' uniformly from t..T-1 inclusive, as Algorithm 1 does, and takes the cell entered by step t'.
    Rows beyond `flight.n_steps` mean nothing. `ends`: a flight may have ended in a blocked cell, which is no goal; a step that
    no other cell follows keeps the goal of the flight.
    """
    entered = flight.transitions.next_cell
    t = jnp.arange(entered.size)[:, None]
    last = flight.n_steps - 1
    if ends:
        last = last - (flight.terminated & ~flight.reached)
    if strategy == "final":
        chosen = jnp.broadcast_to(last, (entered.size, k))
    else:
        first = jnp.minimum(t, last) if strategy == "future" else jnp.zeros_like(t)
        uniform = jax.random.uniform(key, (entered.size, k))
        chosen = jnp.minimum(first + (uniform * (last + 1 - first)).astype(jnp.int32), last)
    if not ends:
        return entered[chosen]
    has_goal = (last >= t) if strategy == "future" else jnp.broadcast_to(last >= 0, t.shape)
    return jnp.where(has_goal, entered[jnp.maximum(chosen, 0)], flight.goal)
