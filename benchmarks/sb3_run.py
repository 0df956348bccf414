"""Stable-Baselines3's side: DQN with its hindsight replay buffer on a Gymnasium environment of the same task."""

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import torch
from goal_flight import GoalFlight
from ours import Case
from stable_baselines3 import DQN, HerReplayBuffer
from stable_baselines3.common.logger import configure

MEAN_EPSILON = 0.325
"""Share of random actions, held constant: the mean of a schedule from 1 to 0.1 over the first half of all episodes."""


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
