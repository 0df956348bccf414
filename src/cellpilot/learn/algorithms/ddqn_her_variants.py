"""DDQN-HER with switches: what section 5.4 takes away from Algorithms 1 and 2, and what the literature adds to them.

With the switches at their defaults it is `ddqn_her`, which is the one to read.
"""

from dataclasses import replace
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import Arena
from cellpilot.envs.flight import Flight
from cellpilot.learn.adam import AdamState, adam_step, init_adam
from cellpilot.learn.algorithms import ddqn_her
from cellpilot.learn.algorithms.ddqn_episode import (
    EpisodeStatistics,
    LearnerState,
    collect,
    columns,
    coordinates_of,
    empty_rows,
    end_episode,
    exploration_at,
    fill_with_random_flights,
)
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHERVariants
from cellpilot.learn.checkpoint import policy_parameters
from cellpilot.learn.compiled import CompiledAlgorithm
from cellpilot.learn.exploration import NOISE
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.losses import q_learning_target, squared_td_error, td_error
from cellpilot.learn.n_step import outcome_of_steps
from cellpilot.learn.networks import ARCHITECTURES, Networks, Twins, action_values, fold, members, unfold
from cellpilot.learn.prioritised import importance_weights, renew_priorities
from cellpilot.learn.replay import Experience, Replay, add, draw_rows, init_replay
from cellpilot.policies.learned import PolicyParameters
from cellpilot.streams import Learning, learning_key
from cellpilot.task import Task


@partial(jax.jit, static_argnames="settings")
def initial_state(settings: DDQNHERVariants, arena: Arena, seed: Int[Array, ""] | int) -> LearnerState:
    """Fresh networks (target equal to online) and an empty replay memory."""
    key = learning_key(seed, Learning.INITIAL_STATE)
    sizes = (arena.coordinates.shape[1], arena.next_cell.shape[1], settings.hidden)
    create = partial(ARCHITECTURES[settings.architecture], *sizes)
    network = create(key) if settings.networks == 1 else Twins((create(key), create(jax.random.fold_in(key, 1))))
    replay = init_replay(settings.replay_capacity, settings.n_steps > 1, settings.prioritised)
    target = jax.tree.map(jnp.copy, network)
    return LearnerState(network, target, init_adam(network), replay, jnp.int32(0), jnp.int32(0))


def populate_memory(key: Array, settings: DDQNHERVariants, replay: Replay, flight: Flight, ends: bool = False) -> Replay:
    """Algorithm 1 with any strategy, or none; for returns of several steps with what is left of the flight."""
    own = jnp.broadcast_to(flight.goal, (flight.transitions.action.size, 1))
    again = hindsight_goals(key, flight, settings.hindsight_goals, settings.hindsight_strategy, ends)
    goals = jnp.concatenate([own, again], axis=1)
    steps_left = flight.n_steps - jnp.arange(len(goals)) if settings.n_steps > 1 else None
    copies = settings.copies
    transitions, steps_left = jax.tree.map(lambda field: jnp.repeat(field, copies), (flight.transitions, steps_left))
    return add(replay, Experience(transitions, goals.ravel(), steps_left), flight.n_steps * copies)


class VariantBatches(NamedTuple):
    """`ddqn_her.Batches` with what the switches need besides."""

    plain: ddqn_her.Batches
    discount: Float[Array, "*updates batch"] | None  # None = the task's
    weight: Float[Array, "*updates batch"] | None  # None = all alike


def prepare(
    row: Int[Array, "updates batch"], settings: DDQNHERVariants, arena: Arena, task: Task, state: LearnerState
) -> VariantBatches:
    """The mini-batches of these rows of the memory; the target networks, which do not change, value all in one pass."""
    experiences, priority = state.replay.experiences, state.replay.priority
    outcome = outcome_of_steps(state.replay, row, task, settings.n_steps, settings.copies)
    cells = (experiences.transition.cell[row], outcome.next_cell, experiences.goal[row])
    position, next_position, goal = (coordinates_of(arena, cell) for cell in cells)
    of_targets = [action_values(fold(network), columns(next_position), columns(goal), 0) for network in members(state.target)]
    q_target = reduce(jnp.minimum, of_targets).reshape(-1, *row.shape)
    weight = None
    if priority is not None:
        exponent = 1 - (1 - settings.importance_exponent) * (1 - state.episode / settings.episodes)
        weight = importance_weights(priority, row, state.replay.size, exponent)
    by_update = lambda x: jnp.moveaxis(x, 1, 0)
    plain = ddqn_her.Batches(
        by_update(jnp.concatenate([position, next_position], -1)),
        by_update(jnp.concatenate([goal, goal], -1)),
        experiences.transition.action[row],
        outcome.reward,
        outcome.terminated,
        by_update(q_target),
        None if arena.not_offered is None else by_update(arena.not_offered.T[:, outcome.next_cell]),
    )
    return VariantBatches(plain, outcome.discount, weight)


def loss(
    folded: Networks, batches: VariantBatches, settings: DDQNHERVariants, task: Task, ends: bool = False
) -> tuple[Array, Float[Array, " batch"]]:
    """Loss of equation 3.24, summed over the networks, and the error of each experience, their mean."""
    batch, n = batches.plain, settings.batch_size
    first, *others = members(folded)
    q, q_next_online = jnp.split(action_values(first, batch.position, batch.goal, n).T, 2)
    discount = task.discount if batches.discount is None else batches.discount
    not_offered = None if batch.not_offered is None else batch.not_offered.T
    target = q_learning_target(
        batch.reward, batch.terminated, q_next_online, batch.q_next_target.T, discount, settings.double, not_offered
    )
    if settings.clip_targets:
        target = jnp.clip(target, *task.value_bounds(ends))
    values = [q] + [action_values(network, batch.position[:, :n], batch.goal[:, :n], n).T for network in others]
    errors = jnp.stack([jnp.abs(td_error(q, batch.action, target)) for q in values]).mean(0)
    return jnp.stack([squared_td_error(q, batch.action, target, batches.weight) for q in values]).sum(), errors


def optimize(key: Array, settings: DDQNHERVariants, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """`updates_per_episode` steps of Adam, and the priorities that follow from their errors."""
    row = draw_rows(key, state.replay, (settings.updates_per_episode, settings.batch_size))

    def update(carry: tuple[Networks, AdamState], batch: VariantBatches) -> tuple[tuple[Networks, AdamState], Any]:
        online, adam = carry
        gradient, error = jax.grad(loss, has_aux=True)(online, batch, settings, task, arena.ends)
        return adam_step(online, gradient, adam, settings.learning_rate), error if settings.prioritised else None

    adam = state.optimizer
    start = (fold(state.online), AdamState(fold(adam.mu), fold(adam.nu), adam.n_steps))
    (online, adam), errors = jax.lax.scan(update, start, prepare(row, settings, arena, task, state))
    network = lambda folded: unfold(folded, state.online)
    adam = AdamState(network(adam.mu), network(adam.nu), adam.n_steps)
    replay = state.replay
    if replay.priority is not None:
        replay = replace(replay, priority=renew_priorities(replay.priority, row, errors, settings.priority_exponent))
    return replace(state, online=network(online), optimizer=adam, replay=replay)


def run_round(
    key: Array, settings: DDQNHERVariants, arena: Arena, task: Task, state: LearnerState
) -> tuple[LearnerState, EpisodeStatistics]:
    """The body of Algorithm 2: fly, store, optimize, and now and then renew the target networks."""
    key_flight, key_hindsight, key_batches = jax.random.split(jax.random.fold_in(key, state.episode), 3)
    noise = NOISE[settings.exploration]
    fly_once = sequential_vmap(lambda key, arena, network, amount: collect(key, arena, task, network, amount, noise))
    flight = fly_once(key_flight, arena, members(state.online)[0], exploration_at(settings, state.episode))
    replay = populate_memory(key_hindsight, settings, state.replay, flight, arena.ends)
    state = optimize(key_batches, settings, arena, task, eqx.tree_at(lambda s: s.replay, state, replay))
    return end_episode(settings, task, state, flight)


def fill_replay(key: Array, settings: DDQNHERVariants, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """Random flights until `replay_start` experiences are stored."""
    store = lambda key, replay, flight: populate_memory(key, settings, replay, flight, arena.ends)
    return fill_with_random_flights(key, settings, arena, task, state, store)


def learned_policy(
    state: LearnerState, settings: DDQNHERVariants, sides: tuple[int, int, int], about: dict[str, Any]
) -> PolicyParameters:
    """The online network, the first of two, as plain NumPy weights."""
    return policy_parameters(members(state.online)[0], settings.architecture, sides, about)


ALGORITHM = CompiledAlgorithm(
    initial_state,
    fill_replay,
    run_round,
    empty_rows,
    exploration_at,
    lambda state: state.online,
    learned_policy,
)
