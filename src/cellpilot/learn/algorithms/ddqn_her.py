"""DDQN-HER: Double Deep Q-Learning with Hindsight Experience Replay, Algorithms 1 and 2 of the thesis."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial, reduce
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.custom_batching import sequential_vmap
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import Arena, draw_start_and_goal
from cellpilot.envs.flight import Flight, flight_return, fly
from cellpilot.learn.adam import AdamState, adam_step, init_adam
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.checkpoint import policy_parameters
from cellpilot.learn.exploration import NOISE, linear_schedule
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.losses import q_learning_target, squared_td_error, td_error
from cellpilot.learn.n_step import outcome_of_steps
from cellpilot.learn.networks import ARCHITECTURES, Networks, QNetwork, Twins, action_values, fold, members, unfold
from cellpilot.learn.prioritised import importance_weights, renew_priorities
from cellpilot.learn.replay import Experience, Replay, add, draw_rows, init_replay
from cellpilot.policies.learned import PolicyParameters
from cellpilot.task import Task

MAX_TABLE_CELLS = 8192
"""Up to this many cells, the values of all cells for the goal are computed once per flight (the parameters do not
change during it), and each step looks up its row; beyond, each step evaluates the network."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """Everything that training changes."""

    online: Networks
    target: Networks
    optimizer: AdamState
    replay: Replay
    episode: Int[Array, ""]
    env_steps: Int[Array, ""]

    @property
    def rounds_done(self) -> Int[Array, "..."]:
        """How far training is, as the trainer counts."""
        return self.episode


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EpisodeStatistics:
    """What one training flight looked like; fields `[episodes]` once stacked."""

    episode_return: Float[Array, "..."]
    n_steps: Int[Array, "..."]
    reached: Array


def empty_rows(length: int) -> EpisodeStatistics:
    """Room for the statistics of `length` episodes."""
    return EpisodeStatistics(jnp.zeros(length), jnp.zeros(length, jnp.int32), jnp.zeros(length, bool))


@partial(jax.jit, static_argnames="settings")
def initial_state(settings: DDQNHER, arena: Arena, seed: Int[Array, ""] | int) -> LearnerState:
    """Fresh networks (target equal to online) and an empty replay memory."""
    key = jax.random.fold_in(jax.random.key(seed), 0)
    sizes = (arena.coordinates.shape[1], arena.next_cell.shape[1], settings.hidden)
    create = partial(ARCHITECTURES[settings.architecture], *sizes)
    network = create(key) if settings.networks == 1 else Twins((create(key), create(jax.random.fold_in(key, 1))))
    return LearnerState(
        online=network,
        target=jax.tree.map(jnp.copy, network),
        optimizer=init_adam(network),
        replay=init_replay(settings.replay_capacity, settings.n_steps > 1, settings.prioritised),
        episode=jnp.int32(0),
        env_steps=jnp.int32(0),
    )


def populate_memory(key: Array, settings: DDQNHER, replay: Replay, flight: Flight, ends: bool = False) -> Replay:
    """Algorithm 1: store every step of the flight for its own goal and for `hindsight_ratio` goals it reached.

    `ends`: the flight may have ended in a blocked cell.
    """
    own = jnp.broadcast_to(flight.goal, (flight.transitions.action.size, 1))
    again = hindsight_goals(key, flight, settings.hindsight_ratio, settings.hindsight_strategy, ends)
    goals = jnp.concatenate([own, again], axis=1)
    steps_left = flight.n_steps - jnp.arange(len(goals)) if settings.n_steps > 1 else None
    copies = settings.copies
    transitions, steps_left = jax.tree.map(lambda field: jnp.repeat(field, copies), (flight.transitions, steps_left))
    return add(replay, Experience(transitions, goals.ravel(), steps_left), flight.n_steps * copies)


def collect(
    key: Array, settings: DDQNHER, arena: Arena, task: Task, network: QNetwork | None, exploration: Float[Array, ""]
) -> Flight:
    """One flight between a random pair with the exploring policy; without a network, with the random one."""
    key_pair, key_noise, key_flight = jax.random.split(key, 3)
    start, goal = draw_start_and_goal(key_pair, arena)
    n_cells, n_actions = arena.next_cell.shape
    kind = "boltzmann" if network is None else settings.exploration
    noise = NOISE[kind](key_noise, exploration, (task.max_steps, n_actions))
    q_values: Callable[[Array], Array]
    if network is None:
        q_values = lambda cell: jnp.zeros(n_actions)
    elif n_cells <= MAX_TABLE_CELLS:
        cells = arena.coordinates.T
        table = action_values(fold(network), cells, jnp.broadcast_to(cells[:, goal, None], cells.shape), 0).T
        q_values = lambda cell: table[cell]
    else:
        q_values = lambda cell: network(arena.coordinates[cell], arena.coordinates[goal])
    allowed = lambda cell, values: values if arena.not_offered is None else values + arena.not_offered[cell]
    return fly(key_flight, arena, task, start, goal, lambda cell, t: allowed(cell, q_values(cell) + noise[t]).argmax())


class Batches(NamedTuple):
    """Mini-batches with all that the updates do not change; each field has a leading axis of updates until one is taken."""

    position: Float[Array, "*updates dimensions columns"]  # columns: s, then s'
    goal: Float[Array, "*updates dimensions columns"]
    action: Int[Array, "*updates batch"]
    reward: Float[Array, "*updates batch"]
    terminated: Array
    q_next_target: Float[Array, "*updates actions batch"]
    discount: Float[Array, "*updates batch"] | None  # None = the task's
    weight: Float[Array, "*updates batch"] | None  # None = all alike
    not_offered: Float[Array, "*updates actions batch"] | None  # -inf for actions that s' does not offer; None = all offered


def prepare(row: Int[Array, "updates batch"], settings: DDQNHER, arena: Arena, task: Task, state: LearnerState) -> Batches:
    """The mini-batches of these rows of the memory; the target network, which does not change, values all in one pass."""
    experiences, priority = state.replay.experiences, state.replay.priority
    outcome = outcome_of_steps(state.replay, row, task, settings.n_steps, settings.copies)
    at = lambda cell: arena.coordinates.T[:, cell]  # [dimensions, updates, batch]
    position, next_position, goal = at(experiences.transition.cell[row]), at(outcome.next_cell), at(experiences.goal[row])
    columns = lambda x: x.reshape(len(x), -1)
    of_targets = [action_values(fold(network), columns(next_position), columns(goal), 0) for network in members(state.target)]
    q_target = reduce(jnp.minimum, of_targets).reshape(-1, *row.shape)
    weight = None
    if priority is not None:
        exponent = 1 - (1 - settings.importance_exponent) * (1 - state.episode / settings.episodes)
        weight = importance_weights(priority, row, state.replay.size, exponent)
    by_update = lambda x: jnp.moveaxis(x, 1, 0)
    not_offered = None if arena.not_offered is None else by_update(arena.not_offered.T[:, outcome.next_cell])
    return Batches(
        by_update(jnp.concatenate([position, next_position], -1)),
        by_update(jnp.concatenate([goal, goal], -1)),
        experiences.transition.action[row],
        outcome.reward,
        outcome.terminated,
        by_update(q_target),
        outcome.discount,
        weight,
        not_offered,
    )


def loss(
    folded: Networks, batch: Batches, settings: DDQNHER, task: Task, ends: bool = False
) -> tuple[Array, Float[Array, " batch"]]:
    """Loss of equation 3.24, summed over the networks, and the error of each experience, their mean."""
    n = settings.batch_size
    first, *others = members(folded)
    q, q_next_online = jnp.split(action_values(first, batch.position, batch.goal, n).T, 2)
    discount = task.discount if batch.discount is None else batch.discount
    not_offered = None if batch.not_offered is None else batch.not_offered.T
    target = q_learning_target(
        batch.reward, batch.terminated, q_next_online, batch.q_next_target.T, discount, settings.double, not_offered
    )
    if settings.clip_targets:
        target = jnp.clip(target, *task.value_bounds(ends))
    values = [q] + [action_values(network, batch.position[:, :n], batch.goal[:, :n], n).T for network in others]
    errors = jnp.stack([jnp.abs(td_error(q, batch.action, target)) for q in values]).mean(0)
    return jnp.stack([squared_td_error(q, batch.action, target, batch.weight) for q in values]).sum(), errors


def optimize(key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """`updates_per_episode` steps of Adam on mini-batches from the replay memory.

    The memory does not change between these steps, so all their mini-batches are drawn at once.
    """
    row = draw_rows(key, state.replay, (settings.updates_per_episode, settings.batch_size))

    def update(carry: tuple[Networks, AdamState], batch: Batches) -> tuple[tuple[Networks, AdamState], Any]:
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


def run_episode(
    key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState
) -> tuple[LearnerState, EpisodeStatistics]:
    """The body of Algorithm 2: fly, store with hindsight, optimise, and now and then renew the target network."""
    key_flight, key_hindsight, key_batches = jax.random.split(jax.random.fold_in(key, state.episode), 3)
    exploration = exploration_at(settings, state.episode)
    fly_once = lambda key, arena, network, exploration: collect(key, settings, arena, task, network, exploration)
    # Seeds in one program: mapped over seeds a flight would last as long as the longest one, so they fly one by one.
    flight = sequential_vmap(fly_once)(key_flight, arena, members(state.online)[0], exploration)
    state = eqx.tree_at(lambda s: s.replay, state, populate_memory(key_hindsight, settings, state.replay, flight, arena.ends))
    state = optimize(key_batches, settings, arena, task, state)
    episode = state.episode + 1
    renew = episode % settings.target_period == 0
    target = jax.tree.map(lambda new, old: jnp.where(renew, new, old), state.online, state.target)
    state = LearnerState(state.online, target, state.optimizer, state.replay, episode, state.env_steps + flight.n_steps)
    return state, EpisodeStatistics(flight_return(flight, task), flight.n_steps, flight.reached)


def exploration_at(settings: DDQNHER, episode: Int[Array, "..."]) -> Float[Array, "..."]:
    """Temperature (or epsilon) of an episode: linear over the first `exploration_fraction` of all episodes."""
    return linear_schedule(
        settings.initial_exploration, settings.final_exploration, settings.exploration_fraction, episode / settings.episodes
    )


def learned_policy(
    state: LearnerState, settings: DDQNHER, sides: tuple[int, int, int], about: dict[str, Any]
) -> PolicyParameters:
    """The online network, the first of two, as plain NumPy weights."""
    return policy_parameters(members(state.online)[0], settings.architecture, sides, about)


@partial(jax.jit, static_argnames=("settings", "task"), donate_argnames="state")
def fill_replay(state: LearnerState, arena: Arena, seed: Int[Array, ""], *, settings: DDQNHER, task: Task) -> LearnerState:
    """Fly at random until `replay_start` experiences are stored, those of hindsight included."""
    key = jax.random.fold_in(jax.random.key(seed), 1)

    def fly_once(carry: tuple[Replay, Array, Array]) -> tuple[Replay, Array, Array]:
        replay, flown, env_steps = carry
        key_flight, key_hindsight = jax.random.split(jax.random.fold_in(key, flown))
        flight = collect(key_flight, settings, arena, task, None, jnp.float32(1.0))
        return populate_memory(key_hindsight, settings, replay, flight, arena.ends), flown + 1, env_steps + flight.n_steps

    start = (state.replay, jnp.int32(0), state.env_steps)
    replay, _, env_steps = jax.lax.while_loop(lambda carry: carry[0].size < settings.replay_start, fly_once, start)
    return eqx.tree_at(lambda s: (s.replay, s.env_steps), state, (replay, env_steps))


@partial(jax.jit, static_argnames=("settings", "task", "length"), donate_argnames="state")
def train_chunk(
    state: LearnerState,
    arena: Arena,
    seed: Int[Array, ""],
    n_episodes: Int[Array, ""],
    *,
    settings: DDQNHER,
    task: Task,
    length: int,
) -> tuple[LearnerState, EpisodeStatistics]:
    """Algorithm 2 for `n_episodes <= length` more episodes; statistics `[length]`, real in the first `n_episodes`.

    Randomness is a function of (seed, episode number) alone: how episodes are split into chunks changes nothing.
    """
    key = jax.random.fold_in(jax.random.key(seed), 2)

    def body(i: Array, carry: tuple[LearnerState, EpisodeStatistics]) -> tuple[LearnerState, EpisodeStatistics]:
        state, rows = carry
        state, row = run_episode(key, settings, arena, task, state)
        return state, jax.tree.map(lambda all_rows, new: all_rows.at[i].set(new), rows, row)

    return jax.lax.fori_loop(0, n_episodes, body, (state, empty_rows(length)))
