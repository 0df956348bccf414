"""Targets of FQI-HER: what the value of each pair of cell and goal should be, kept in a cache, and what is fitted next."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from cellpilot.airspace import ENTERED, MOVED
from cellpilot.envs.arena import Arena
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.pair_network import PairNetwork, corrections
from cellpilot.learn.penalty import CellMeasurements, replayed_penalty
from cellpilot.policies.pair_value import distance, neighbour, upper_bound
from cellpilot.task import Task

MOST_IMPORTANT = 5.0
"""Largest factor of `importance`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TargetCache:
    """Targets of all cells for many goals, a column for each; each round renews the oldest ones."""

    goal: Int[Array, " columns"]
    target: Float[Array, "columns cells"]
    error: Float[Array, "columns cells"]  # of the averaged network, when the column was new
    useful: Bool[Array, "columns cells"]  # false where there is nothing to learn: the goal itself, cells cut off from it
    renewed: Int[Array, " cells"]  # round after which each goal was renewed last


def empty_cache(columns: int, n_cells: int) -> TargetCache:
    """No column of it is in use."""
    zero = jnp.zeros((columns, n_cells))
    return TargetCache(jnp.zeros(columns, jnp.int32), zero, zero, zero > 0, jnp.zeros(n_cells, jnp.int32))


def pair_values(
    network: PairNetwork, arena: Arena, task: Task, penalty: Float[Array, " cells"] | None, cell: Array, goal: Array
) -> tuple[Float[Array, "networks ..."], Float[Array, "..."]]:
    """Each network's value of the pairs, and their upper bound: of being in the cell, or without a model of entering it."""
    steps = distance(arena.sides, cell, goal, arena.diagonal)
    bound = upper_bound(task, steps, 0.0 if penalty is None else penalty[goal])
    if penalty is None:
        bound = task.entering_reward(cell, 0.0, task.end(cell, MOVED, goal)[0]) + task.discount * bound
    return bound + corrections(network, arena.sides, cell, goal), bound


def arena_move_rewards(arena: Arena, task: Task) -> Float[Array, "cells actions"]:
    """The part of the reward that the move decides; -inf for a move that is not offered."""
    cell, action = jnp.arange(arena.n_cells)[:, None], jnp.arange(arena.next_cell.shape[1])[None, :]
    reward = jnp.broadcast_to(task.move_reward(cell, action, arena.next_cell, arena.event), arena.event.shape)
    return reward if arena.not_offered is None else reward + arena.not_offered


def targets(
    key: Array,
    settings: FQIHER,
    arena: Arena,
    task: Task,
    network: PairNetwork,
    memory: CellMeasurements,
    penalty: Float[Array, " cells"],
    goals: Int[Array, " goals"],
) -> tuple[Float[Array, "cells goals"], Float[Array, "cells goals"]]:
    """Targets of every cell for these goals, and the absolute error of the network.

    With the penalty model: `sweeps` steps of value iteration over the known moves, begun at the network's values (the
    least of the networks). Without: the penalty of one replayed measurement, and one step.
    """
    cell, goal = jnp.arange(arena.n_cells)[:, None], goals[None, :]
    model = penalty if settings.penalty_model else None
    values, bound = pair_values(network, arena, task, model, cell, goal)
    least = jnp.minimum(values.min(0), bound)
    if not settings.penalty_model:
        value = (least[arena.next_cell] + arena_move_rewards(arena, task)[..., None]).max(1)
        reached, over = task.end(cell, jnp.where((arena.part < 0) & arena.ends, ENTERED, MOVED)[:, None], goal)
        low = replayed_penalty(key, memory, task.threshold_db)[:, None]
        target = task.entering_reward(cell, low, reached) + jnp.where(over, 0.0, task.discount * value)
        return jnp.minimum(target, bound), jnp.abs(target - values.mean(0))
    n_actions = arena.next_cell.shape[1]
    outcomes = [task.expected_outcome(arena, cell, action, goal, penalty) for action in range(n_actions)]

    def sweep(_: Array, value: Array) -> Array:
        best = jnp.full_like(value, -jnp.inf)
        for action, (reward, _, over) in enumerate(outcomes):
            future = jnp.where(over, 0.0, task.discount * value[arena.next_cell[:, action]])
            offered = 0.0 if arena.not_offered is None else arena.not_offered[:, action, None]
            best = jnp.maximum(best, reward + future + offered)
        return best

    target = jnp.minimum(jax.lax.fori_loop(0, settings.sweeps, sweep, least), bound)
    return target, jnp.abs(target - values.mean(0))


def importance(task: Task, value: Float[Array, "..."]) -> Float[Array, "..."]:
    """What an error counts: more where a step of waiting costs less, since an error above that cost lets a flight circle.

    A step spent waiting costs `-rho_step + (1 - discount) * value`; 1 where that is `-rho_step`, at most `MOST_IMPORTANT`.
    """
    return 1.0 / jnp.maximum(1.0 - (1.0 - task.discount) * value / task.rho_step, 1.0 / MOST_IMPORTANT)


def draw_pairs(
    key: Array, settings: FQIHER, arena: Arena, cache: TargetCache, n_columns: Int[Array, ""]
) -> tuple[Int[Array, "updates batch"], Int[Array, "updates batch"]]:
    """Columns and cells of every mini-batch: shares `prioritised` in proportion to the error, `near` the goal, the rest even."""
    shape = (settings.updates_per_round, settings.batch_size)
    n_urgent, n_near = int(settings.prioritised * shape[1]), int(settings.near * shape[1])
    key_column, key_cell, key_near, key_urgent, key_level = jax.random.split(key, 5)
    column = jax.random.randint(key_column, shape, 0, n_columns)
    cell = jax.random.randint(key_cell, shape, 0, arena.n_cells)
    offsets = jax.random.randint(key_near, (3, shape[0], n_near), -settings.near_cells, settings.near_cells + 1)
    near = neighbour(arena.sides, cache.goal[column[:, n_urgent : n_urgent + n_near]], offsets)
    edges = jnp.cumsum(cache.error, 1)
    by_column = jnp.cumsum(edges[:, -1])
    level = jax.random.uniform(key_urgent, (shape[0] * n_urgent,)) * by_column[-1]
    urgent = jnp.minimum(jnp.searchsorted(by_column, level), by_column.size - 1)
    level = jax.random.uniform(key_level, level.shape) * edges[urgent, -1]
    urgent_cell = _search(edges, urgent, level)
    column = column.at[:, :n_urgent].set(urgent.reshape(-1, n_urgent))
    cell = cell.at[:, :n_urgent].set(urgent_cell.reshape(-1, n_urgent))
    return column, cell.at[:, n_urgent : n_urgent + n_near].set(near)


def _search(
    edges: Float[Array, "columns cells"], column: Int[Array, " draws"], level: Float[Array, " draws"]
) -> Int[Array, " draws"]:
    """First cell of each column whose edge is not below the level, by halving: no column is copied, as `searchsorted` would."""
    low, high = jnp.zeros_like(column), jnp.full_like(column, edges.shape[1] - 1)
    for _ in range(edges.shape[1].bit_length()):
        middle = (low + high) // 2
        below = edges[column, middle] < level
        low, high = jnp.where(below, jnp.minimum(middle + 1, high), low), jnp.where(below, high, middle)
    return low
