"""DDQN-HER: Double Deep Q-Learning with Hindsight Experience Replay, Algorithms 1 and 2 of the thesis."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

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
from cellpilot.learn.losses import q_learning_target, squared_td_error
from cellpilot.learn.networks import ARCHITECTURES, QNetwork, action_values, fold, unfold
from cellpilot.learn.replay import Experience, Replay, add, init_replay, sample
from cellpilot.policies.learned import PolicyParameters
from cellpilot.task import Task

MAX_TABLE_CELLS = 8192
"""Up to this many cells, the values of all cells for the goal are computed once per flight (the parameters do not
change during it), and each step looks up its row; beyond, each step evaluates the network."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """Everything that training changes."""

    online: QNetwork
    target: QNetwork
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
    network = ARCHITECTURES[settings.architecture](arena.coordinates.shape[1], arena.next_cell.shape[1], settings.hidden, key)
    return LearnerState(
        online=network,
        target=jax.tree.map(jnp.copy, network),
        optimizer=init_adam(network),
        replay=init_replay(settings.replay_capacity),
        episode=jnp.int32(0),
        env_steps=jnp.int32(0),
    )


def populate_memory(key: Array, settings: DDQNHER, replay: Replay, flight: Flight) -> Replay:
    """Algorithm 1: store every step of the flight for its own goal and for `hindsight_ratio` goals it reached."""
    own = jnp.broadcast_to(flight.goal, (flight.transitions.action.size, 1))
    again = hindsight_goals(key, flight, settings.hindsight_ratio, settings.hindsight_strategy)
    goals = jnp.concatenate([own, again], axis=1)
    copies = goals.shape[1]
    transitions = jax.tree.map(lambda field: jnp.repeat(field, copies), flight.transitions)
    return add(replay, Experience(transitions, goals.ravel()), flight.n_steps * copies)


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
    return fly(key_flight, arena, task, start, goal, lambda cell, t: (q_values(cell) + noise[t]).argmax())


def optimize(key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState) -> LearnerState:
    """`updates_per_episode` steps of Adam on mini-batches from the replay memory, loss of equation 3.24.

    The memory does not change between these steps, so all their mini-batches are drawn at once, and the target network,
    which does not change either, values them all in one pass.
    """
    shape = (settings.updates_per_episode, settings.batch_size)
    batches = sample(key, state.replay, shape)
    rewards, terminated = task.outcome(batches.transition, batches.goal)
    at = lambda cell: arena.coordinates.T[:, cell]  # [dimensions, updates, batch]
    position, next_position, goal = at(batches.transition.cell), at(batches.transition.next_cell), at(batches.goal)
    columns = lambda x: x.reshape(len(x), -1)
    q_target = action_values(fold(state.target), columns(next_position), columns(goal), 0).reshape(-1, *shape)
    both = (jnp.concatenate([position, next_position], -1), jnp.concatenate([goal, goal], -1))  # columns: s, then s'

    def update(carry: tuple[QNetwork, AdamState], batch: tuple[Array, ...]) -> tuple[tuple[QNetwork, AdamState], None]:
        online, adam = carry
        positions, goals, action, reward, terminated, q_next_target = batch

        def loss(network: QNetwork) -> Array:
            q, q_next_online = jnp.split(action_values(network, positions, goals, settings.batch_size).T, 2)
            target = q_learning_target(reward, terminated, q_next_online, q_next_target.T, task.discount, settings.double)
            if settings.clip_targets:
                target = jnp.clip(target, *task.value_bounds)
            return squared_td_error(q, action, target)

        return adam_step(online, jax.grad(loss)(online), adam, settings.learning_rate), None

    by_update = lambda x: jnp.moveaxis(x, 1, 0)
    batch = (*map(by_update, both), batches.transition.action, rewards, terminated, by_update(q_target))
    adam = state.optimizer
    start = (fold(state.online), AdamState(fold(adam.mu), fold(adam.nu), adam.n_steps))
    (online, adam), _ = jax.lax.scan(update, start, batch)
    network = lambda folded: unfold(folded, state.online)
    adam = AdamState(network(adam.mu), network(adam.nu), adam.n_steps)
    return eqx.tree_at(lambda s: (s.online, s.optimizer), state, (network(online), adam))


def run_episode(
    key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState
) -> tuple[LearnerState, EpisodeStatistics]:
    """The body of Algorithm 2: fly, store with hindsight, optimise, and now and then renew the target network."""
    key_flight, key_hindsight, key_batches = jax.random.split(jax.random.fold_in(key, state.episode), 3)
    exploration = exploration_at(settings, state.episode)
    fly_once = lambda key, arena, network, exploration: collect(key, settings, arena, task, network, exploration)
    # Seeds in one program: mapped over seeds a flight would last as long as the longest one, so they fly one by one.
    flight = sequential_vmap(fly_once)(key_flight, arena, state.online, exploration)
    state = eqx.tree_at(lambda s: s.replay, state, populate_memory(key_hindsight, settings, state.replay, flight))
    state = optimize(key_batches, settings, arena, task, state)
    episode = state.episode + 1
    renew = episode % settings.target_period == 0
    target = jax.tree.map(lambda new, old: jnp.where(renew, new, old), state.online, state.target)
    state = LearnerState(state.online, target, state.optimizer, state.replay, episode, state.env_steps + flight.n_steps)
    return state, EpisodeStatistics(flight_return(flight, task), flight.n_steps, flight.terminated)


def exploration_at(settings: DDQNHER, episode: Int[Array, "..."]) -> Float[Array, "..."]:
    """Temperature (or epsilon) of an episode: linear over the first `exploration_fraction` of all episodes."""
    return linear_schedule(
        settings.initial_exploration, settings.final_exploration, settings.exploration_fraction, episode / settings.episodes
    )


def learned_policy(
    state: LearnerState, settings: DDQNHER, sides: tuple[int, int, int], about: dict[str, Any]
) -> PolicyParameters:
    """The online network as plain NumPy weights."""
    return policy_parameters(state.online, settings.architecture, sides, about)


@partial(jax.jit, static_argnames=("settings", "task"), donate_argnames="state")
def fill_replay(state: LearnerState, arena: Arena, seed: Int[Array, ""], *, settings: DDQNHER, task: Task) -> LearnerState:
    """Fly at random until `replay_start` experiences are stored, those of hindsight included."""
    key = jax.random.fold_in(jax.random.key(seed), 1)

    def fly_once(carry: tuple[Replay, Array, Array]) -> tuple[Replay, Array, Array]:
        replay, flown, env_steps = carry
        key_flight, key_hindsight = jax.random.split(jax.random.fold_in(key, flown))
        flight = collect(key_flight, settings, arena, task, None, jnp.float32(1.0))
        return populate_memory(key_hindsight, settings, replay, flight), flown + 1, env_steps + flight.n_steps

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
