"""Stable-Baselines3's side: DQN with its hindsight replay buffer on a Gymnasium environment of the same task."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from ours import Case
from stable_baselines3 import DQN, HerReplayBuffer
from stable_baselines3.common.logger import configure

from cellpilot.errors import InputError
from cellpilot.task import Task, Transition
from cellpilot.world import World

MEAN_EPSILON = 0.325
"""Share of random actions, held constant: the mean of a schedule from 1 to 0.1 over the first half of all episodes."""

Observation = dict[str, NDArray[np.float32]]


class GoalFlight(gymnasium.Env[Observation, np.int64]):
    """One flight at a time, goal-conditioned, in plain Python; everything that can be looked up is.

    Only for worlds without noise, map uncertainty and blocked cells: `compute_reward` sees two positions, not a measurement.
    """

    def __init__(self, world: World, task: Task):
        if world.noise_std_db or world.sinr_std_db.any() or world.blocked.any():
            raise InputError("GoalFlight derives rewards from positions alone: use a world without noise and blocked cells")
        grid = world.grid
        self.max_steps, self.rho_goal = task.max_steps, task.rho_goal
        self.sides = np.asarray(grid.sides[: grid.n_dimensions])
        self.strides = np.cumprod([1, *self.sides[:-1]])
        cells = np.arange(grid.n_cells)
        self.coordinates = ((grid.position(cells)[:, : grid.n_dimensions] + 1) / self.sides).astype(np.float32)
        self.reward_of_entering, _ = task.outcome(Transition(cells, None, cells, world.sinr_db, world.stopped[:, 0]), -1)
        self.rows = list(self.coordinates)
        self.next_cells: list[list[int]] = world.next_cell.tolist()
        self.rewards: list[float] = self.reward_of_entering.tolist()
        self.free_cells: list[int] = world.free_cells.tolist()
        box = spaces.Box(0.0, 1.0, (grid.n_dimensions,), np.float32)
        self.observation_space = spaces.Dict({"observation": box, "achieved_goal": box, "desired_goal": box})
        self.action_space = spaces.Discrete(grid.n_actions)
        self.cell, self.goal, self.n_steps = 0, 1, 0

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """A new pair of different cells."""
        super().reset(seed=seed)
        start, goal = self.np_random.choice(len(self.free_cells), 2, replace=False)
        self.cell, self.goal, self.n_steps = self.free_cells[start], self.free_cells[goal], 0
        return self._observation(), {}

    def step(self, action: np.int64) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Observation, reward, terminated, truncated, no further information."""
        self.cell = self.next_cells[self.cell][action]
        self.n_steps += 1
        terminated = self.cell == self.goal
        reward = self.rewards[self.cell] + self.rho_goal * terminated
        return self._observation(), reward, terminated, self.n_steps >= self.max_steps and not terminated, {}

    def compute_reward(
        self, achieved_goal: NDArray[np.float32], desired_goal: NDArray[np.float32], info: object
    ) -> NDArray[np.float64]:
        """Rewards `[...]` of entering the achieved positions `[..., dims]` on the way to the desired ones."""
        cell = np.rint(achieved_goal * self.sides - 1).astype(np.int64) @ self.strides
        return self.reward_of_entering[cell] + self.rho_goal * (achieved_goal == desired_goal).all(-1)

    def _observation(self) -> Observation:
        here = self.rows[self.cell]
        return {"observation": here.copy(), "achieved_goal": here.copy(), "desired_goal": self.rows[self.goal].copy()}


@dataclass(frozen=True)
class Peer:
    """The model, and two hindsight buffers that are both full."""

    model: DQN
    same_flights: HerReplayBuffer  # as many flown steps as our memory holds: 500,000 experiences are three per step
    same_number: HerReplayBuffer  # 500,000 flown steps


def make_peer(case: Case) -> Peer:
    """DQN with the thesis's settings as far as it has them; both buffers filled by random flights."""
    settings = case.settings
    hindsight = {"n_sampled_goal": settings.hindsight_ratio, "goal_selection_strategy": "future"}
    model = DQN(
        "MultiInputPolicy",
        GoalFlight(case.world, case.task),
        learning_rate=settings.learning_rate,
        buffer_size=settings.replay_capacity // (1 + settings.hindsight_ratio),
        learning_starts=0,
        batch_size=settings.batch_size,
        gamma=case.task.discount,
        train_freq=(1, "episode"),
        gradient_steps=0,  # `learn` only flies; `train` is called apart, so that each can be timed
        replay_buffer_class=HerReplayBuffer,
        replay_buffer_kwargs=hindsight,
        target_update_interval=1000,
        exploration_initial_eps=MEAN_EPSILON,
        exploration_final_eps=MEAN_EPSILON,
        policy_kwargs={"net_arch": list(settings.hidden), "activation_fn": torch.nn.LeakyReLU},
        device="cpu",
        seed=0,
    )
    model.set_logger(configure(None, []))
    small = model.replay_buffer
    large = HerReplayBuffer(
        settings.replay_capacity, model.observation_space, model.action_space, model.get_env(), device="cpu", **hindsight
    )
    assert isinstance(small, HerReplayBuffer)
    fill_with_random_flights([small, large], GoalFlight(case.world, case.task))
    return Peer(model, small, large)


def fill_with_random_flights(buffers: list[HerReplayBuffer], env: GoalFlight) -> None:
    """Store random flights until every buffer has been full once."""
    rng = np.random.default_rng(0)
    observation, _ = env.reset(seed=0)
    while not all(buffer.full for buffer in buffers):
        for action in rng.integers(env.action_space.n, size=1000):
            after, reward, terminated, truncated, _ = env.step(action)
            row = (
                {name: value[None] for name, value in observation.items()},
                {name: value[None] for name, value in after.items()},
                np.array([action]),
                np.array([reward]),
                np.array([terminated or truncated]),
                [{"TimeLimit.truncated": truncated}],
            )
            for buffer in buffers:
                if not buffer.full:
                    buffer.add(*row)
            observation = env.reset()[0] if terminated or truncated else after


def make_sb3_update(peer: Peer, buffer: HerReplayBuffer, case: Case, rounds: int) -> Callable[[], float]:
    """A function that trains `rounds` times as after one episode and returns the seconds per gradient step."""
    updates, batch_size = case.settings.updates_per_episode, case.settings.batch_size

    def seconds_per_update() -> float:
        peer.model.replay_buffer = buffer
        began = time.perf_counter()
        for _ in range(rounds):
            peer.model.train(gradient_steps=updates, batch_size=batch_size)
        return (time.perf_counter() - began) / (rounds * updates)

    return seconds_per_update


def make_sb3_step(peer: Peer, steps: int) -> Callable[[], float]:
    """A function that flies at least `steps` steps without training and returns the seconds per environment step."""

    def seconds_per_step() -> float:
        model = peer.model
        model.replay_buffer = peer.same_flights
        flown = model.num_timesteps
        began = time.perf_counter()
        model.learn(steps, log_interval=None, reset_num_timesteps=False)
        return (time.perf_counter() - began) / (model.num_timesteps - flown)

    return seconds_per_step
