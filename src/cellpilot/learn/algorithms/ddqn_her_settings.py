"""Settings of DDQN-HER as compiled code needs them. No JAX here: they are checked before anything slow is imported."""

from dataclasses import dataclass
from typing import Literal

from cellpilot.errors import InputError
from cellpilot.task import Task

Exploration = Literal["boltzmann", "epsilon-greedy"]
Strategy = Literal["future", "final", "episode"]
Architecture = Literal["concatenated", "two-stream"]


@dataclass(frozen=True)
class DDQNHER:
    """Settings of the learner as compiled code needs them; `scenario.LearnerSettings` documents each (Table 4.3)."""

    episodes: int = 30_000
    batch_size: int = 32
    replay_capacity: int = 500_000
    replay_start: int = 50_000
    updates_per_episode: int = 30
    target_period: int = 10
    learning_rate: float = 1e-3
    exploration: Exploration = "boltzmann"
    initial_exploration: float = 2.0
    final_exploration: float = 0.1
    exploration_fraction: float = 0.5
    hindsight_ratio: int = 2
    hindsight_strategy: Strategy = "future"
    double: bool = True
    clip_targets: bool = True
    architecture: Architecture = "concatenated"
    hidden: tuple[int, ...] = (50, 50, 50)


def check_fits(settings: DDQNHER, task: Task) -> None:
    """`InputError` before anything is compiled if the replay memory cannot hold a flight, or its random start."""
    rows = task.max_steps * (1 + settings.hindsight_ratio)
    if rows > settings.replay_capacity:
        raise InputError(
            f"replay_capacity is {settings.replay_capacity}, but one flight can store {rows} experiences "
            f"({task.max_steps} steps x {1 + settings.hindsight_ratio}): raise replay_capacity or lower max_steps"
        )
    if settings.replay_start > settings.replay_capacity:
        raise InputError(
            f"replay_start {settings.replay_start} is larger than replay_capacity {settings.replay_capacity}; lower it"
        )
