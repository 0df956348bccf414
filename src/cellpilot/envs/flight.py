"""One flight and many: step after step through an `Arena`, compiled."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cellpilot.envs.arena import Arena
from cellpilot.task import Task, Transition

Carry = tuple[Array, Array, Array, Array]
ChooseAction = Callable[[Int[Array, ""], Int[Array, ""]], Int[Array, ""]]
"""(cell, step number) -> action."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flight:
    """The facts of one flight, padded to the cap on steps; only the first `n_steps` rows are real."""

    transitions: Transition  # fields [steps]
    goal: Int[Array, ""]
    n_steps: Int[Array, ""]
    terminated: Bool[Array, ""]  # reached the goal; a flight that did not was truncated by the cap


def step(arena: Arena, cell: Int[Array, ""], action: Int[Array, ""], deviation_db: Float[Array, ""]) -> Transition:
    """Facts of one step; `deviation_db` is what this measurement differs from the map's mean."""
    next_cell = arena.next_cell[cell, action]
    return Transition(cell, action, next_cell, arena.sinr_db[next_cell] + deviation_db, arena.stopped[cell, action])


def fly(key: Array, arena: Arena, task: Task, start: Int[Array, ""], goal: Int[Array, ""], choose: ChooseAction) -> Flight:
    """Fly from `start` until the goal is entered or `task.max_steps` are flown.

    The loop itself only follows the cells; the measurements (noise drawn at every step, the map's own uncertainty
    once per flight) are added to the whole flight afterwards.
    """
    max_steps = task.max_steps

    def going_on(carry: Carry) -> Array:
        cell, n_steps, _, _ = carry
        return (cell != goal) & (n_steps < max_steps)

    def move(carry: Carry) -> Carry:
        cell, n_steps, actions, next_cells = carry
        action = choose(cell, n_steps)
        next_cell = arena.next_cell[cell, action]
        return next_cell, n_steps + 1, actions.at[n_steps].set(action), next_cells.at[n_steps].set(next_cell)

    empty = jnp.zeros(max_steps, jnp.int32)
    last, n_steps, actions, next_cells = jax.lax.while_loop(going_on, move, (start, jnp.zeros((), jnp.int32), empty, empty))
    cells = jnp.concatenate([start[None], next_cells[:-1]])
    transitions = jax.vmap(step, (None, 0, 0, 0))(arena, cells, actions, _deviation_db(key, arena, next_cells))
    return Flight(transitions, goal, n_steps, last == goal)


def flight_return(flight: Flight, task: Task) -> Float[Array, ""]:
    """Sum of rewards of the real steps, undiscounted."""
    reward, _ = task.outcome(flight.transitions, flight.goal)
    return jnp.where(jnp.arange(task.max_steps) < flight.n_steps, reward, 0.0).sum()


def _deviation_db(key: Array, arena: Arena, cells: Int[Array, " steps"]) -> Float[Array, " steps"]:
    key_noise, key_map = jax.random.split(key)
    noise = _normal(key_noise, jnp.broadcast_to(arena.noise_std_db, cells.shape))
    return noise + _normal(key_map, arena.sinr_std_db)[cells]


def _normal(key: Array, std: Float[Array, " n"]) -> Float[Array, " n"]:
    """Draws with these standard deviations; nothing is drawn where there is no spread at all."""
    return jax.lax.cond(std.any(), lambda: std * jax.random.normal(key, std.shape), lambda: jnp.zeros_like(std))
