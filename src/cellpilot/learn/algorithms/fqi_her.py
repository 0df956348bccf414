"""FQI-HER: fitted Q-iteration over pairs of cells with hindsight goals; near-exact arg max policies.

A round: all flights fly some steps and measure; goals are drawn from all cells flights have entered (hindsight: any of
them could have been the goal); the averaged network values every cell for these goals, and known moves with the learned
penalty turn that into targets, which are kept until their goal's turn comes again; the network is fitted to pairs of cell
and goal drawn from all targets kept, those with large errors more often.

With `penalty_model` off the penalty of a move is that of one stored measurement, replayed, and the network alone decides:
model-free as far as the radio is concerned. The moves of the grid are known to both.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from cellpilot.envs.arena import Arena, draw_start_and_goal
from cellpilot.envs.flight import step
from cellpilot.learn.adam import AdamState, adam_step, init_adam
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.fqi_her_targets import (
    TargetCache,
    arena_move_rewards,
    draw_pairs,
    empty_cache,
    importance,
    pair_values,
    targets,
)
from cellpilot.learn.compiled import CompiledAlgorithm
from cellpilot.learn.exploration import boltzmann_noise, linear_schedule
from cellpilot.learn.losses import huber
from cellpilot.learn.pair_network import PairNetwork
from cellpilot.learn.penalty import CellMeasurements, measure, no_measurements, penalty_model
from cellpilot.policies.learned import PolicyParameters
from cellpilot.policies.pair_value import ARCHITECTURE
from cellpilot.streams import Learning, learning_key
from cellpilot.task import Task


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Flights:
    """Many flights in the air, `[flights]`; one that ends is replaced by a new pair of start and goal."""

    cell: Int[Array, " flights"]
    goal: Int[Array, " flights"]
    n_steps: Int[Array, " flights"]
    return_so_far: Float[Array, " flights"]
    error_db: Float[Array, "flights cells"] | None  # of the map, as this flight meets it; None where all is known


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class FittedState:
    """Everything that training changes."""

    online: PairNetwork
    average: PairNetwork
    optimizer: AdamState
    memory: CellMeasurements
    cache: TargetCache
    flights: Flights
    blocked: Bool[Array, " cells"]
    round: Int[Array, ""]
    env_steps: Int[Array, ""]

    @property
    def rounds_done(self) -> Int[Array, "..."]:
        """How far training is, as the trainer counts."""
        return self.round


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RoundStatistics:
    """Means over the flights that ended in a round, NaN where none did; fields `[rounds]` once stacked."""

    episode_return: Float[Array, "..."]
    n_steps: Float[Array, "..."]
    reached: Float[Array, "..."]
    flights: Float[Array, "..."]  # that ended


def empty_rows(length: int) -> RoundStatistics:
    """Room for the statistics of `length` rounds."""
    return RoundStatistics(*(jnp.zeros(length) for _ in range(4)))


@partial(jax.jit, static_argnames="settings")
def initial_state(settings: FQIHER, arena: Arena, seed: Int[Array, ""] | int) -> FittedState:
    """A fresh network, nothing measured, all flights at their starts."""
    key_network, key_flights = jax.random.split(learning_key(seed, Learning.INITIAL_STATE))
    network = PairNetwork(arena.sides, settings.hidden_units, settings.networks, key_network)
    return FittedState(
        online=network,
        average=jax.tree.map(jnp.copy, network),
        optimizer=init_adam(network),
        memory=no_measurements(arena.n_cells, settings.stored_per_cell),
        cache=empty_cache(min(settings.cached_goals, arena.n_cells), arena.n_cells),
        flights=_new_flights(key_flights, arena, settings.flights),
        blocked=arena.part < 0,
        round=jnp.int32(0),
        env_steps=jnp.int32(0),
    )


def flying_values(
    network: PairNetwork,
    arena: Arena,
    task: Task,
    penalty: Float[Array, " cells"] | None,
    cell: Int[Array, " flights"],
    goal: Int[Array, " flights"],
) -> Float[Array, "flights actions"]:
    """Q of every action, as the policy that flies on NumPy computes it."""
    entered = arena.next_cell[cell]
    goal = goal[:, None]
    values, bound = pair_values(network, arena, task, penalty, entered, goal)
    value = jnp.minimum(values.min(0), bound)
    if penalty is not None:
        here = cell[:, None]
        reward, _, over = task.expected_outcome(arena, here, jnp.arange(entered.shape[1])[None, :], goal, penalty)
        values = reward + task.discount * jnp.where(over, 0.0, value)
    else:
        values = value + arena_move_rewards(arena, task)[cell]
    return values if arena.not_offered is None else values + arena.not_offered[cell]


def collect(
    key: Array,
    settings: FQIHER,
    arena: Arena,
    task: Task,
    state: FittedState,
    penalty: Float[Array, " cells"],
) -> tuple[Flights, CellMeasurements, RoundStatistics]:
    """`steps_per_round` steps of every flight with the Boltzmann policy of the averaged network."""
    temperature = exploration_at(settings, state.round)
    model = penalty if settings.penalty_model else None

    def fly_step(
        carry: tuple[Flights, CellMeasurements, Array], key: Array
    ) -> tuple[tuple[Flights, CellMeasurements, Array], None]:
        flights, memory, ended = carry
        key_action, key_noise, key_new = jax.random.split(key, 3)
        q = flying_values(state.average, arena, task, model, flights.cell, flights.goal)
        rarely = settings.count_bonus / jnp.sqrt(1.0 + memory.count[arena.next_cell[flights.cell]])
        action = (q + rarely + boltzmann_noise(key_action, temperature, q.shape)).argmax(-1)
        entered = arena.next_cell[flights.cell, action]
        noise = jax.random.normal(key_noise, entered.shape)
        error_db = None if flights.error_db is None else flights.error_db[jnp.arange(entered.size), entered]
        transition = jax.vmap(step, (None, 0, 0, 0, 0))(arena, flights.cell, action, error_db, noise)
        reward, reached, terminated = task.outcome(transition, flights.goal)
        memory = measure(memory, transition.next_cell, transition.sinr_db)
        n_steps, total = flights.n_steps + 1, flights.return_so_far + reward
        over = terminated | (n_steps >= task.max_steps)
        ended = ended + jnp.stack([over, over * total, over * n_steps, reached], 0).sum(1)
        new = _new_flights(key_new, arena, settings.flights)
        going = Flights(transition.next_cell, flights.goal, n_steps, total, flights.error_db)
        renew = lambda fresh, old: jnp.where(over.reshape(-1, *[1] * (old.ndim - 1)), fresh, old)
        return (jax.tree.map(renew, new, going), memory, ended), None

    start = (state.flights, state.memory, jnp.zeros(4))
    (flights, memory, ended), _ = jax.lax.scan(fly_step, start, jax.random.split(key, settings.steps_per_round))
    n, total, n_steps, reached = ended
    mean = lambda sum_: jnp.where(n > 0, sum_ / jnp.maximum(n, 1.0), jnp.nan)
    return flights, memory, RoundStatistics(mean(total), mean(n_steps), mean(reached), n)


def renew_targets(
    key: Array, settings: FQIHER, arena: Arena, task: Task, state: FittedState, penalty: Float[Array, " cells"]
) -> TargetCache:
    """The cache with new columns for `goals_per_round` hindsight goals, those first that have waited longest."""
    key_goals, key_targets = jax.random.split(key)
    cache = state.cache
    waited = state.round - cache.renewed  # goals not entered by any flight come last, impossible ones never before them
    urgency = waited + jax.random.uniform(key_goals, waited.shape) + 1e6 * (state.memory.count > 0) + 1e7 * arena.may_be_goal
    goals = jax.lax.top_k(urgency, min(settings.goals_per_round, cache.goal.size))[1]
    target, error = targets(key_targets, settings, arena, task, state.average, state.memory, penalty, goals)
    useful = arena.part[:, None] == arena.part[goals][None, :]
    if settings.penalty_model:  # the value of being in the goal is 0 and needs no learning
        useful = useful & (jnp.arange(arena.n_cells)[:, None] != goals[None, :])
    column = (state.round * goals.size + jnp.arange(goals.size)) % cache.goal.size
    return TargetCache(
        cache.goal.at[column].set(goals),
        cache.target.at[column].set(target.T),
        cache.error.at[column].set(jnp.where(useful, importance(task, target) * error, 0.0).T),
        cache.useful.at[column].set(useful.T),
        cache.renewed.at[goals].set(state.round + 1),
    )


def optimize(
    key: Array, settings: FQIHER, arena: Arena, task: Task, state: FittedState, penalty: Float[Array, " cells"]
) -> FittedState:
    """Fit the networks to the cached targets, `updates_per_round` steps of Adam."""
    cache = state.cache
    column, cells = draw_pairs(
        key, settings, arena, cache, jnp.minimum((state.round + 1) * settings.goals_per_round, cache.goal.size)
    )
    rate = learning_rate_at(settings, state.round)
    model = penalty if settings.penalty_model else None

    def update(
        carry: tuple[PairNetwork, PairNetwork, AdamState], batch: tuple[Array, ...]
    ) -> tuple[tuple[PairNetwork, PairNetwork, AdamState], None]:
        online, average, adam = carry
        cell, goal, wanted, useful = batch

        weight = importance(task, wanted)

        def loss(network: PairNetwork) -> Array:
            error = pair_values(network, arena, task, model, cell, goal)[0] - wanted
            return (useful * huber(weight * error)).mean(-1).sum()

        online, adam = adam_step(online, jax.grad(loss)(online), adam, rate)
        average = jax.tree.map(lambda a, b: a + settings.averaging * (b - a), average, online)
        return (online, average, adam), None

    batches = (cells, cache.goal[column], cache.target[column, cells], cache.useful[column, cells])
    (online, average, adam), _ = jax.lax.scan(update, (state.online, state.average, state.optimizer), batches)
    return eqx.tree_at(lambda s: (s.online, s.average, s.optimizer), state, (online, average, adam))


def run_round(key: Array, settings: FQIHER, arena: Arena, task: Task, state: FittedState) -> tuple[FittedState, RoundStatistics]:
    """Fly, measure, fit."""
    key_flights, key_fit = jax.random.split(jax.random.fold_in(key, state.round))
    before = penalty_model(state.memory, task.threshold_db)
    flights, memory, statistics = collect(key_flights, settings, arena, task, state, before)
    flown = settings.flights * settings.steps_per_round
    after = (memory, flights, state.env_steps + flown)
    state = eqx.tree_at(lambda s: (s.memory, s.flights, s.env_steps), state, after)
    penalty = penalty_model(memory, task.threshold_db)
    key_targets, key_pairs = jax.random.split(key_fit)
    cache = renew_targets(key_targets, settings, arena, task, state, penalty)
    state = eqx.tree_at(lambda s: s.cache, state, cache)
    state = optimize(key_pairs, settings, arena, task, state, penalty)
    return eqx.tree_at(lambda s: s.round, state, state.round + 1), statistics


def exploration_at(settings: FQIHER, round_: Int[Array, "..."]) -> Float[Array, "..."]:
    """Temperature of a round: linear over the first `exploration_fraction` of all rounds."""
    share = round_ / settings.rounds
    return linear_schedule(settings.initial_exploration, settings.final_exploration, settings.exploration_fraction, share)


def learning_rate_at(settings: FQIHER, round_: Int[Array, ""]) -> Float[Array, ""]:
    """Learning rate of a round: half a cosine from `learning_rate` to `final_learning_rate`."""
    share = 0.5 * (1 + jnp.cos(jnp.pi * round_ / settings.rounds))
    return settings.final_learning_rate + (settings.learning_rate - settings.final_learning_rate) * share


def learned_policy(state: FittedState, settings: FQIHER, sides: tuple[int, int, int], about: dict[str, Any]) -> PolicyParameters:
    """The averaged network, the learned penalty and the blocked cells as plain NumPy; `about["task"]` holds the rewards."""
    task = Task(**about["task"])
    tensors = {name: np.asarray(getattr(state.average, name)) for name in ("table", "weight", "bias", "output")}
    tensors["blocked"] = np.asarray(state.blocked)
    if settings.penalty_model:
        tensors["penalty"] = np.asarray(penalty_model(state.memory, task.threshold_db))
    look_ahead = settings.look_ahead if settings.penalty_model else 1
    return PolicyParameters(tensors, ARCHITECTURE, sides, about | {"look_ahead": look_ahead})


def _new_flights(key: Array, arena: Arena, n: int) -> Flights:
    key_pairs, key_map = jax.random.split(key)
    start, goal = jax.vmap(draw_start_and_goal, (0, None))(jax.random.split(key_pairs, n), arena)
    unknown, error_db = arena.signal.unknown, None
    if unknown is not None:
        error_db = unknown.draw(jax.random.normal(key_map, (n, arena.n_cells)))
    return Flights(start, goal, jnp.zeros(n, jnp.int32), jnp.zeros(n), error_db)


ALGORITHM = CompiledAlgorithm(
    initial_state, None, run_round, empty_rows, exploration_at, lambda state: state.average, learned_policy
)
