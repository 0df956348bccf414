"""What DDQN-HER and its variants share: their state, a flight by the values of a network, and the fast form of those values."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from cellpilot.envs.arena import Arena, draw_start_and_goal
from cellpilot.envs.flight import Flight, flight_return, fly
from cellpilot.learn.adam import AdamState
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.exploration import boltzmann_noise, linear_schedule
from cellpilot.learn.networks import QNetwork, action_values, fold
from cellpilot.learn.replay import Replay
from cellpilot.task import Task

MAX_TABLE_CELLS = 8192
"""Up to this many cells, the values of all cells for the goal are computed once per flight (the parameters do not
change during it), and each step looks up its row; beyond, each step evaluates the network."""

DrawNoise = Callable[[Array, Float[Array, ""], tuple[int, int]], Float[Array, "steps actions"]]
"""(key, exploration, shape) -> noise on the values: a function of `learn.exploration`."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class LearnerState:
    """Everything that training changes."""

    online: Any  # networks: one, or two of a variant
    target: Any
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


def end_episode(settings: DDQNHER, task: Task, state: LearnerState, flight: Flight) -> tuple[LearnerState, EpisodeStatistics]:
    """The last lines of an episode: count it, renew the target network every C episodes, and the row of its flight."""
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


def collect(
    key: Array,
    arena: Arena,
    task: Task,
    network: QNetwork | None,
    exploration: Float[Array, ""],
    draw_noise: DrawNoise = boltzmann_noise,
) -> Flight:
    """One flight between a random pair by the arg max of values and noise; without a network, at random."""
    key_pair, key_noise, key_flight = jax.random.split(key, 3)
    start, goal = draw_start_and_goal(key_pair, arena)
    noise = draw_noise(key_noise, exploration, (task.max_steps, arena.next_cell.shape[1]))
    q_values = _values_for(arena, network, goal)
    allowed = lambda cell, values: values if arena.not_offered is None else values + arena.not_offered[cell]
    return fly(key_flight, arena, task, start, goal, lambda cell, t: allowed(cell, q_values(cell) + noise[t]).argmax())


def _values_for(arena: Arena, network: QNetwork | None, goal: Int[Array, ""]) -> Callable[[Array], Array]:
    """cell -> values of its actions for this goal."""
    n_cells, n_actions = arena.next_cell.shape
    if network is None:
        return lambda cell: jnp.zeros(n_actions)
    if n_cells > MAX_TABLE_CELLS:
        return lambda cell: network(arena.coordinates[cell], arena.coordinates[goal])
    cells = arena.coordinates.T
    table = action_values(fold(network), cells, jnp.broadcast_to(cells[:, goal, None], cells.shape), 0).T
    return lambda cell: table[cell]


def fill_with_random_flights(
    key: Array, settings: DDQNHER, arena: Arena, task: Task, state: LearnerState, store: Callable[[Array, Replay, Flight], Replay]
) -> LearnerState:
    """Fly at random until `replay_start` experiences are stored, those of hindsight included."""

    def fly_once(carry: tuple[Replay, Array, Array]) -> tuple[Replay, Array, Array]:
        replay, flown, env_steps = carry
        key_flight, key_hindsight = jax.random.split(jax.random.fold_in(key, flown))
        flight = collect(key_flight, arena, task, None, jnp.float32(1.0))
        return store(key_hindsight, replay, flight), flown + 1, env_steps + flight.n_steps

    start = (state.replay, jnp.int32(0), state.env_steps)
    replay, _, env_steps = jax.lax.while_loop(lambda carry: carry[0].size < settings.replay_start, fly_once, start)
    return eqx.tree_at(lambda s: (s.replay, s.env_steps), state, (replay, env_steps))


def coordinates_of(arena: Arena, cell: Int[Array, "..."]) -> Float[Array, "dimensions ..."]:
    """Network inputs of cells, each a column."""
    return arena.coordinates.T[:, cell]


def columns(x: Any) -> Any:
    """`[rows, ...]` as a matrix of columns."""
    return x.reshape(len(x), -1)
