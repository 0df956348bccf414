"""FQI-HER on another network than the one it was trained on: it goes on learning, one flight at a time.

Nothing changes but what is measured: after each flight the measurements go into the same memory and the same network is
fitted for some more rounds. What was measured before counts as very few measurements of each cell, or the new network
would never be believed.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.fqi_her import ALGORITHM, FittedState, initial_state, learned_policy, optimize, renew_targets
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner import receiver, start_and_goal
from cellpilot.learn.compile import single_precision
from cellpilot.learn.compiled import train_chunk
from cellpilot.learn.penalty import CellMeasurements, measure, penalty_model
from cellpilot.policies import LearnedPolicy
from cellpilot.streams import Flying, Learning, learning_key, stream
from cellpilot.task import Task
from cellpilot.world import World


@dataclass(frozen=True)
class OnlineSettings:
    """How it goes on learning."""

    rounds_per_flight: int = 5  # of targets and updates, after each flight
    learning_rate: float = 1e-3
    temperature: float = 0.1  # of the Boltzmann policy that flies


@single_precision
def train_beforehand(settings: FQIHER, world: World, task: Task, seed: int) -> FittedState:
    """FQI-HER trained in `world`, all rounds in one call.

    `train_chunk` is compiled once for all seeds that one process trains; the trainer compiles it anew each time.
    """
    settings.check_fits(task, world.grid)
    arena = make_arena(world)
    state, n = initial_state(settings, arena, seed), settings.rounds
    bound = {"algorithm": ALGORITHM, "settings": settings, "task": task, "length": n}
    return train_chunk(state, arena, jnp.int32(seed), jnp.int32(n), **bound)[0]


@single_precision
def remembered(memory: CellMeasurements) -> CellMeasurements:
    """Each measured cell as if it had been measured twice, with its mean and spread."""
    count = jnp.maximum(memory.count, 1)
    mean_db = memory.first_db + memory.sum_db / count
    variance = jnp.maximum(memory.sum_squared_db / count - (memory.sum_db / count) ** 2, 0.0)
    seen = memory.count > 0
    # Two measurements a either side of the mean have the variance a^2.
    first_db = mean_db - jnp.sqrt(variance)
    step_db = 2 * jnp.sqrt(variance)
    zero = jnp.zeros_like(mean_db)
    return CellMeasurements(
        jnp.where(seen, 2, 0).astype(memory.count.dtype),
        jnp.where(seen, first_db, zero),
        jnp.where(seen, step_db, zero),
        jnp.where(seen, step_db**2, zero),
        jnp.stack([first_db, first_db + step_db], -1)[:, jnp.arange(memory.last_db.shape[1]) % 2],
    )


@single_precision
@partial(jax.jit, static_argnames=("settings", "task", "n_rounds"))
def learn_from_flight(
    state: FittedState,
    arena: Arena,
    seed: Int[Array, ""],
    cells: Int[Array, " cap"],
    sinr_db: Float[Array, " cap"],
    n_steps: Int[Array, ""],
    *,
    settings: FQIHER,
    task: Task,
    n_rounds: int,
) -> FittedState:
    """The first `n_steps` measurements taken in, and `n_rounds` rounds of targets and updates."""
    add = lambda i, memory: measure(memory, cells[i][None], sinr_db[i][None])
    memory = jax.lax.fori_loop(0, n_steps, add, state.memory)
    state = eqx.tree_at(lambda s: (s.memory, s.env_steps), state, (memory, state.env_steps + n_steps))
    penalty = penalty_model(memory, task.threshold_db)

    def fit(_: Array, state: FittedState) -> FittedState:
        key = jax.random.fold_in(learning_key(seed, Learning.GOING_ON), state.round)
        key_targets, key_pairs = jax.random.split(key)
        cache = renew_targets(key_targets, settings, arena, task, state, penalty)
        state = optimize(key_pairs, settings, arena, task, eqx.tree_at(lambda s: s.cache, state, cache), penalty)
        return eqx.tree_at(lambda s: s.round, state, state.round + 1)

    return jax.lax.fori_loop(0, n_rounds, fit, state)


def learn_online(
    state: FittedState,
    settings: FQIHER,
    world: World,
    task: Task,
    seed: int,
    checkpoints: Sequence[int],
    online: OnlineSettings | None = None,
) -> Iterator[LearnedPolicy]:
    """The arg max policy after each number of flights of `checkpoints` (increasing) in `world`, begun with a trained state.

    Starts, goals and noise of a flight are those that the map learner meets with the same seed.
    """
    online = OnlineSettings() if online is None else online
    arena = make_arena(world)
    settings = settings.changed(learning_rate=online.learning_rate, final_learning_rate=online.learning_rate)
    state = eqx.tree_at(lambda s: s.memory, state, remembered(state.memory))
    flight = 0
    for checkpoint in checkpoints:
        while flight < checkpoint:
            boltzmann = replace(argmax_policy(state, settings, world.grid, task), temperature=online.temperature)
            cells, sinr_db, n_steps = _fly(boltzmann, world, task, seed, flight)
            state = learn_from_flight(
                state,
                arena,
                jnp.int32(seed),
                jnp.asarray(cells),
                jnp.asarray(sinr_db),
                jnp.int32(n_steps),
                settings=settings,
                task=task,
                n_rounds=online.rounds_per_flight,
            )
            flight += 1
        yield argmax_policy(state, settings, world.grid, task)


@single_precision
def argmax_policy(state: FittedState, settings: FQIHER, grid: Grid, task: Task) -> LearnedPolicy:
    """What the state flies."""
    return LearnedPolicy(learned_policy(state, settings, grid.sides, {"task": task.as_dict()}), grid)


def _fly(policy: LearnedPolicy, world: World, task: Task, seed: int, flight: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Cells entered and SINR measured there, both padded to the cap, and the number of steps."""
    rng = stream(seed, Flying.CHOICES, flight)
    here, goal = start_and_goal(world, seed, flight)
    measured = receiver(world, seed, flight)
    chances = policy.action_probabilities(np.array([goal]))[:, 0].astype(np.float64)
    cells, sinr_db = np.zeros(task.max_steps, np.int32), np.zeros(task.max_steps, np.float32)
    for step in range(task.max_steps):
        action = int((np.cumsum(chances[here])[:-1] <= rng.random()).sum())
        here, event = int(world.airspace.next_cell[here, action]), world.airspace.event[here, action]
        cells[step], sinr_db[step] = here, measured(here)
        if task.end(here, event, goal)[1]:
            break
    return cells, sinr_db, step + 1
