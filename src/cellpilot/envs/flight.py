"""One flight and many: step after step through an `Arena`, compiled."""

from collections.abc import Callable
from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cellpilot.airspace import MOVED
from cellpilot.envs.arena import Arena
from cellpilot.task import Task, Transition

Carry = tuple[Array, Array, Array, Array, Array]
ChooseAction = Callable[[Int[Array, ""], Int[Array, ""]], Int[Array, ""]]
"""(cell, step number) -> action."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flight:
    """The facts of one flight, padded to the cap on steps; only the first `n_steps` rows are real."""

    transitions: Transition  # fields [steps]
    goal: Int[Array, ""]
    n_steps: Int[Array, ""]
    reached: Bool[Array, ""]  # the goal
    terminated: Bool[Array, ""]  # ended by the task; a flight that was not was truncated by the cap


def step(
    arena: Arena,
    cell: Int[Array, ""],
    action: Int[Array, ""],
    error_db: Float[Array, ""] | None,
    noise: Float[Array, ""] | None,
) -> Transition:
    """Facts of one step; `error_db` is the error of the map in the cell entered, `noise` a standard normal number."""
    next_cell = arena.next_cell[cell, action]
    return Transition(cell, action, next_cell, arena.signal.measure(next_cell, error_db, noise), arena.event[cell, action])


def fly(key: Array, arena: Arena, task: Task, start: Int[Array, ""], goal: Int[Array, ""], choose: ChooseAction) -> Flight:
    """Fly from `start` until the task ends the flight or `task.max_steps` are flown.

    The loop itself only follows the cells; the measurements (noise drawn at every step, the map's own error once per
    flight) are added to the whole flight afterwards.
    """
    max_steps = task.max_steps

    def going_on(carry: Carry) -> Array:
        _, n_steps, over, _, _ = carry
        return ~over & (n_steps < max_steps)

    def move(carry: Carry) -> Carry:
        cell, n_steps, _, actions, next_cells = carry
        action = choose(cell, n_steps)
        next_cell = arena.next_cell[cell, action]
        _, over = task.end(next_cell, arena.event[cell, action], goal)
        return next_cell, n_steps + 1, over, actions.at[n_steps].set(action), next_cells.at[n_steps].set(next_cell)

    empty = jnp.zeros(max_steps, jnp.int32)
    start_carry = (start, jnp.zeros((), jnp.int32), jnp.zeros((), bool), empty, empty)
    last, n_steps, over, actions, next_cells = jax.lax.while_loop(going_on, move, start_carry)
    cells = jnp.concatenate([start[None], next_cells[:-1]])
    transitions = jax.vmap(step, (None, 0, 0, 0, 0))(arena, cells, actions, *_draws(key, arena, next_cells))
    return Flight(transitions, goal, n_steps, over & task.end(last, MOVED, goal)[0], over)


def flight_return(flight: Flight, task: Task) -> Float[Array, ""]:
    """Sum of rewards of the real steps, undiscounted."""
    reward = task.outcome(flight.transitions, flight.goal).reward
    return jnp.where(jnp.arange(task.max_steps) < flight.n_steps, reward, 0.0).sum()


def _draws(key: Array, arena: Arena, cells: Int[Array, " steps"]) -> tuple[Array | None, Array | None]:
    """The error of the map in the cells of one flight, and a noise for each of its steps; nothing is drawn without need."""
    key_noise, key_map = jax.random.split(key)
    draw = lambda: jax.random.normal(key_noise, cells.shape)
    noise = jax.lax.cond(arena.signal.noise_std_db > 0, draw, lambda: jnp.zeros(cells.shape))
    if arena.signal.unknown is None:
        return None, noise
    return arena.signal.unknown.draw(jax.random.normal(key_map, arena.signal.mean_db.shape))[cells], noise
