"""Temporal-difference losses with a mathematical definition; every argument `[batch]` or `[batch, actions]`."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int


def q_learning_target(
    reward: Float[Array, " batch"],
    terminated: Bool[Array, " batch"],
    q_next_online: Float[Array, "batch actions"],
    q_next_target: Float[Array, "batch actions"],
    discount: float | Float[Array, " batch"],
    double: bool,
    not_offered: Float[Array, "batch actions"] | None = None,
) -> Float[Array, " batch"]:
    """r + discount x Q_target(s', a'), zero after termination; a flight truncated by the cap bootstraps.

    `double`: a' is the best action of the online network (equation 3.24), else of the target network (3.22).
    `not_offered` is -inf for actions that s' does not offer, else 0.
    Of two target networks `q_next_target` is the minimum, action by action (clipped double Q, Fujimoto et al. 2018).
    """
    chooser = q_next_online if double else q_next_target
    chooser = chooser if not_offered is None else chooser + not_offered
    best = jax.nn.one_hot(chooser.argmax(-1), chooser.shape[-1])
    return reward + discount * jnp.where(terminated, 0.0, (q_next_target * best).sum(-1))


def td_error(
    q: Float[Array, "batch actions"], action: Int[Array, " batch"], target: Float[Array, " batch"]
) -> Float[Array, " batch"]:
    """target - Q(s, a); no gradient flows into the target."""
    taken = (q * jax.nn.one_hot(action, q.shape[-1])).sum(-1)
    return jax.lax.stop_gradient(target) - taken


def squared_td_error(
    q: Float[Array, "batch actions"],
    action: Int[Array, " batch"],
    target: Float[Array, " batch"],
    weight: Float[Array, " batch"] | None = None,
) -> Float[Array, ""]:
    """Mean of `td_error` squared, each times its weight where there are weights."""
    squared = jnp.square(td_error(q, action, target))
    return squared.mean() if weight is None else (weight * squared).mean()


def huber(error: Float[Array, "..."], delta: float = 0.5) -> Float[Array, "..."]:
    """error^2 / 2 up to `delta`, then linear (Huber 1964)."""
    size = jnp.abs(error)
    return jnp.where(size <= delta, 0.5 * error**2, delta * (size - 0.5 * delta))
