"""Settings of DDQN-HER as compiled code needs them. No JAX here: they are checked before anything slow is imported."""

from dataclasses import dataclass
from typing import ClassVar, Literal

from cellpilot.errors import InputError
from cellpilot.memory import check_memory
from cellpilot.task import Task

Exploration = Literal["boltzmann", "epsilon-greedy"]
Strategy = Literal["future", "final", "episode"]
Architecture = Literal["concatenated", "two-stream", "dueling"]

EXPERIENCE_BYTES = 21
"""Of one experience in `learn.replay`: four integers and a float of four bytes, and one flag."""
STEPS_LEFT_BYTES = PRIORITY_BYTES = 4
"""More of each, with returns of several steps and with prioritised replay."""


@dataclass(frozen=True)
class DDQNHER:
    """Settings of the learner as compiled code needs them; `scenario.LearnerSettings` documents each (Table 4.3)."""

    algorithm: ClassVar[str] = "ddqn-her"
    counts: ClassVar[str] = "episodes"
    chunk_rounds: ClassVar[int] = 250

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
    n_steps: int = 1
    prioritised: bool = False
    priority_exponent: float = 0.6
    importance_exponent: float = 0.4
    networks: int = 1

    @property
    def rounds(self) -> int:
        """A round is one flight and the updates after it."""
        return self.episodes

    @property
    def updates(self) -> int:
        """Optimisation steps of the whole training."""
        return self.episodes * self.updates_per_episode

    @property
    def copies(self) -> int:
        """Experiences stored for each step: one for the flight's own goal, the others in hindsight."""
        return 1 + self.hindsight_ratio

    @property
    def experience_bytes(self) -> int:
        """Memory of one experience with all that is kept beside it."""
        return EXPERIENCE_BYTES + STEPS_LEFT_BYTES * (self.n_steps > 1) + PRIORITY_BYTES * self.prioritised

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "temperature" if self.exploration == "boltzmann" else "epsilon"

    def check_fits(self, task: Task, n_seeds: int = 1) -> None:
        """`InputError` before anything is compiled if the replay memory cannot hold a flight, or its random start.

        The same if the replay memories of all seeds are larger than the memory there is.
        """
        rows = task.max_steps * self.copies
        if rows > self.replay_capacity:
            raise InputError(
                f"replay_capacity is {self.replay_capacity}, but one flight can store {rows} experiences "
                f"({task.max_steps} steps x {self.copies}): raise replay_capacity or lower max_steps"
            )
        if self.replay_start > self.replay_capacity:
            raise InputError(f"replay_start {self.replay_start} is larger than replay_capacity {self.replay_capacity}; lower it")
        of_seeds = f" for each of {n_seeds} seeds" if n_seeds > 1 else ""
        check_memory(
            n_seeds * self.replay_capacity * self.experience_bytes,
            f"a replay memory of {self.replay_capacity:,} experiences{of_seeds}",
            "lower replay_capacity" + " or train fewer seeds at once" * (n_seeds > 1),
        )
