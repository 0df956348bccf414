"""Stable-Baselines3's DQN with its hindsight replay buffer, trained on an environment of cellpilot.

Usage: pip install 'cellpilot[gym]' stable-baselines3
       python examples/sb3_her.py [--env cellpilot/Thesis2D-v0] [--steps 30000] [--seed 0] [--flights 200] [--out MODEL.zip]
"""

import argparse
import sys
from collections.abc import Callable, Sequence

import gymnasium
import numpy as np
from stable_baselines3 import DQN, HerReplayBuffer

import cellpilot.gym
from cellpilot.envs.goal_env import GoalEnv
from cellpilot.errors import InputError

gymnasium.register_envs(cellpilot.gym)


def main(arguments: Sequence[str] | None = None) -> int:
    """Train, then compare the greedy policy with random flights; 0, or 2 for wrong input."""
    options = _options(arguments)
    try:
        env = gymnasium.make(options.env, **({"map_file": options.map_file} if options.map_file else {}))
    except (InputError, gymnasium.error.Error) as error:
        sys.stderr.write(f"sb3_her: {error}\n")
        return 2
    model = make_model(env, options.steps, options.seed)
    model.learn(options.steps)
    rng = np.random.default_rng(options.seed)
    policies: dict[str, Callable[[dict[str, np.ndarray]], np.int64]] = {
        "random": lambda observation: rng.integers(env.action_space.n),
        "DQN, arg max": lambda observation: np.int64(model.predict(observation, deterministic=True)[0]),
    }
    for name, choose in policies.items():
        reached, mean_return = fly(env, choose, options.flights, seed=options.seed)
        sys.stdout.write(f"{name:<14} {reached:6.1%} of {options.flights} goals reached, mean return {mean_return:7.2f}\n")
    if options.out:
        model.save(options.out)
    return 0


def make_model(env: gymnasium.Env, steps: int, seed: int) -> DQN:
    """The learner; its exploration falls over the first half of `steps`."""
    assert isinstance(env.unwrapped, GoalEnv)
    return DQN(
        "MultiInputPolicy",
        env,
        learning_rate=1e-3,
        buffer_size=max(1000, steps),
        learning_starts=env.unwrapped.rules.task.max_steps + 1,  # the buffer draws from flights that have ended
        batch_size=128,
        gamma=0.995,
        train_freq=4,
        gradient_steps=2,
        target_update_interval=500,
        exploration_fraction=0.5,
        exploration_final_eps=0.1,
        policy_kwargs={"net_arch": [64, 64, 64]},
        replay_buffer_class=HerReplayBuffer,
        # The rewards depend on the SINR that was measured. It stands in `info`, so the buffer has to keep that.
        replay_buffer_kwargs={"n_sampled_goal": 2, "goal_selection_strategy": "future", "copy_info_dict": True},
        device="cpu",
        seed=seed,
    )


def fly(env: gymnasium.Env, choose: Callable[[dict[str, np.ndarray]], np.int64], flights: int, seed: int) -> tuple[float, float]:
    """Share of goals reached and mean return over flights between the same pairs for every policy."""
    returns, reached = [], []
    for flight in range(flights):
        observation, _ = env.reset(seed=1_000_000 + flights * seed + flight)
        total, over, terminated = 0.0, False, False
        while not over:
            observation, reward, terminated, truncated, _ = env.step(choose(observation))
            total, over = total + float(reward), terminated or truncated
        returns.append(total)
        reached.append(terminated)
    return float(np.mean(reached)), float(np.mean(returns))


def _options(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Train SB3's DQN with hindsight on an environment of cellpilot.")
    parser.add_argument("--env", default="cellpilot/Thesis2D-v0", help="name of the environment (default %(default)s)")
    parser.add_argument("--map-file", help="map of cellpilot/RadioMap-v0")
    parser.add_argument("--steps", type=int, default=30_000, help="steps flown in training (default %(default)s)")
    parser.add_argument("--flights", type=int, default=200, help="flights of the comparison (default %(default)s)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", help="where to keep the model (.zip)")
    options = parser.parse_args(arguments)
    if options.steps < 1 or options.flights < 1 or options.seed < 0:
        parser.error("expected --steps and --flights of at least 1 and --seed of at least 0")
    return options


if __name__ == "__main__":
    sys.exit(main())
