"""DDQN-HER as published: Double Deep Q-Learning with Hindsight Experience Replay, Algorithms 1 and 2 of the thesis.

Switches and further variants are in `ddqn_her_variants`; the fast form of the network is `networks.perceptron`.
"""

from functools import partial
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import Arena
from cellpilot.envs.flight import Flight
from cellpilot.learn.adam import AdamState, adam_step, init_adam
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
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.checkpoint import policy_parameters
from cellpilot.learn.compiled import CompiledAlgorithm
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.losses import q_learning_target, squared_td_error
from cellpilot.learn.networks import ConcatenatedQ, action_values, fold, unfold
from cellpilot.learn.replay import Experience, Replay, add, draw_rows, init_replay
from cellpilot.policies.learned import PolicyParameters
from cellpilot.streams import Learning, learning_key
from cellpilot.task import Task


@partial(jax.jit, static_argnames="settings")
def initial_state(settings: DDQNHER, arena: Arena, seed: Int[Array, ""] | int) -> LearnerState:
    """A fresh network (target equal to online) and an empty replay memory."""
    n_dimensions, n_actions = arena.coordinates.shape[1], arena.next_cell.shape[1]
    network = ConcatenatedQ(n_dimensions, n_actions, settings.hidden, learning_key(seed, Learning.INITIAL_STATE))
    target, replay = jax.tree.map(jnp.copy, network), init_replay(settings.replay_capacity)
    return LearnerState(network, target, init_adam(network), replay, jnp.int32(0), jnp.int32(0))


def populate_memory(key: Array, settings: DDQNHER, replay: Replay, flight: Flight, ends: bool = False) -> Replay:
    """Algorithm 1: store every step of the flight for its own goal and for k goals that it reached later (strategy future).

    `ends`: the flight may have ended in a blocked cell.
    """
    own = jnp.broadcast_to(flight.goal, (flight.transitions.action.size, 1))
    later = hindsight_goals(key, flight, settings.hindsight_ratio, "future", ends)
    goals = jnp.concatenate([own, later], axis=1)
    transitions = jax.tree.map(lambda field: jnp.repeat(field, settings.copies), flight.transitions)
    return add(replay, Experience(transitions, goals.ravel()), flight.n_steps * settings.copies)


class Batches(NamedTuple):
    """Mini-batches with all that the updates do not change; each field has a leading axis of updates until one is taken."""

    position: Float[Array, "*updates dimensions columns"]  # columns: s, then s'
    goal: Float[Array, "*updates dimensions columns"]
    action: Int[Array, "*updates batch"]
    reward: Float[Array, "*updates batch"]
    terminated: Array
    q_next_target: Float[Array, "*updates actions batch"]
    not_offered: Float[Array, "*updates actions batch"] | None  # -inf for actions that s' does not offer; None = all offered


def prepare(row: Int[Array, "updates batch"], arena: Arena, task: Task, state: LearnerState) -> Batches:
    """The mini-batches of these rows of the memory; the target network, which does not change, values all in one pass."""
    transition, goal_cell, _ = jax.tree.map(lambda ring: ring[row], state.replay.experiences)
    outcome = task.outcome(transition, goal_cell)  # reward and end are derived here, for own and hindsight goals alike
    position, next_position, goal = (coordinates_of(arena, c) for c in (transition.cell, transition.next_cell, goal_cell))
    q_next = action_values(fold(state.target), columns(next_position), columns(goal), 0).reshape(-1, *row.shape)
    by_update = lambda x: jnp.moveaxis(x, 1, 0)
    return Batches(
        by_update(jnp.concatenate([position, next_position], -1)),
        by_update(jnp.concatenate([goal, goal], -1)),
        transition.action,
        outcome.reward,
        outcome.terminated,
        by_update(q_next),
        None if arena.not_offered is None else by_update(arena.not_offered.T[:, transition.next_cell]),
    )


def loss(folded: ConcatenatedQ, batch: Batches, task: Task, ends: bool = False) -> Float[Array, ""]:
    """Equation 3.24: the online network chooses the next action, the target network values it."""
    n = batch.action.size
    q, q_next_online = jnp.split(action_values(folded, batch.position, batch.goal, n).T, 2)
    not_offered = None if batch.not_offered is None else batch.not_offered.T
    target = q_learning_target(
        batch.reward, batch.terminated, q_next_online, batch.q_next_target.T, task.discount, True, not_offered
    )
    target = jnp.clip(target, *task.value_bounds(ends))  # ours: without it some seeds diverge (docs/deviations.md)
    return squared_td_error(q, batch.action, target)


def optimize(key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """`updates_per_episode` steps of Adam; the memory does not change meanwhile, so all mini-batches are drawn at once."""
    row = draw_rows(key, state.replay, (settings.updates_per_episode, settings.batch_size))

    def update(carry: tuple[ConcatenatedQ, AdamState], batch: Batches) -> tuple[tuple[ConcatenatedQ, AdamState], None]:
        online, adam = carry
        return adam_step(online, jax.grad(loss)(online, batch, task, arena.ends), adam, settings.learning_rate), None

    adam = state.optimizer
    start = (fold(state.online), AdamState(fold(adam.mu), fold(adam.nu), adam.n_steps))
    (online, adam), _ = jax.lax.scan(update, start, prepare(row, arena, task, state))
    adam = AdamState(unfold(adam.mu, state.online), unfold(adam.nu, state.online), adam.n_steps)
    return eqx.tree_at(lambda s: (s.online, s.optimizer), state, (unfold(online, state.online), adam))


def run_round(
    key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState
) -> tuple[LearnerState, EpisodeStatistics]:
    """An episode, the body of Algorithm 2: fly, store with hindsight, optimize, and now and then renew the target network."""
    key_flight, key_hindsight, key_batches = jax.random.split(jax.random.fold_in(key, state.episode), 3)
    # Mapped over seeds a flight would last as long as the longest one, so seeds in one program fly one by one.
    fly_once = sequential_vmap(lambda key, arena, network, temperature: collect(key, arena, task, network, temperature))
    flight = fly_once(key_flight, arena, state.online, exploration_at(settings, state.episode))
    replay = populate_memory(key_hindsight, settings, state.replay, flight, arena.ends)
    state = optimize(key_batches, settings, arena, task, eqx.tree_at(lambda s: s.replay, state, replay))
    return end_episode(settings, task, state, flight)


def fill_replay(key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """The first lines of Algorithm 2: random flights until M experiences are stored."""
    store = lambda key, replay, flight: populate_memory(key, settings, replay, flight, arena.ends)
    return fill_with_random_flights(key, settings, arena, task, state, store)


def learned_policy(
    state: LearnerState, settings: DDQNHER, sides: tuple[int, int, int], about: dict[str, Any]
) -> PolicyParameters:
    """The online network as plain NumPy weights."""
    return policy_parameters(state.online, "concatenated", sides, about)


ALGORITHM = CompiledAlgorithm(
    initial_state, fill_replay, run_round, empty_rows, exploration_at, lambda state: state.online, learned_policy
)
