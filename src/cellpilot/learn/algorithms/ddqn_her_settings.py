"""Settings of DDQN-HER, as published and with its switches. No JAX here: they are checked before anything slow is imported."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, model_validator

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.base import ALGORITHM_HELP, LearnerSettings
from cellpilot.memory import check_memory
from cellpilot.settings import Count, NonNegative, Positive
from cellpilot.task import Task

if TYPE_CHECKING:
    from cellpilot.learn.learner import Learner, Place

Exploration = Literal["boltzmann", "epsilon-greedy"]
Strategy = Literal["future", "final", "episode"]
Architecture = Literal["concatenated", "two-stream", "dueling"]

EXPERIENCE_BYTES = 21
"""Of one experience in `learn.replay`: four integers and a float of four bytes, and one flag."""
STEPS_LEFT_BYTES = PRIORITY_BYTES = 4
"""More of each, with returns of several steps and with prioritised replay."""


class DDQNHER(LearnerSettings):
    """The published learner DDQN-HER (section 4.3, Table 4.3)."""

    counts: ClassVar[str] = "episodes"
    chunk_rounds: ClassVar[int] = 250

    algorithm: Literal["ddqn-her"] = Field("ddqn-her", description=ALGORITHM_HELP)
    episodes: Count = Field(30_000, description="number of episodes N (Table 4.3: 30,000 in 2D, 50,000 in 3D)")
    batch_size: Count = Field(32, description="mini-batch size (Table 4.3)")
    replay_capacity: int = Field(
        500_000, ge=1, le=100_000_000, description="experiences in the replay memory, hindsight included (Table 4.3)"
    )
    replay_start: Count = Field(50_000, description="random experiences M before learning, hindsight included (Table 4.3)")
    updates_per_episode: Count = Field(30, description="optimization steps after each episode (Table 4.3)")
    target_period: Count = Field(10, description="episodes between renewals of the target network C (Table 4.3)")
    learning_rate: Positive = Field(1e-3, description="learning rate of Adam (Table 4.3)")
    initial_exploration: NonNegative = Field(2.0, description="initial temperature, or epsilon (Table 4.3)")
    final_exploration: NonNegative = Field(0.1, description="final temperature, or epsilon (Table 4.3)")
    exploration_fraction: float = Field(0.5, gt=0, le=1, description="share of episodes of the descent (Table 4.3: 0.5, 3D 0.7)")
    hindsight_ratio: Count = Field(2, description="hindsight goals stored beside each own experience, k (Table 4.3)")
    hidden_layers: Count = Field(3, description="hidden layers (section 4.3)")
    hidden_units: Count = Field(50, description="units of each hidden layer (section 4.3)")

    @model_validator(mode="after")
    def _start_fits(self) -> "DDQNHER":
        if self.replay_start > self.replay_capacity:
            raise ValueError(f"replay_start {self.replay_start} is larger than replay_capacity {self.replay_capacity}; lower it")
        return self

    @property
    def n_rounds(self) -> int:
        """A round is one flight and the updates after it."""
        return self.episodes

    @property
    def updates(self) -> int:
        """Optimization steps of the whole training."""
        return self.episodes * self.updates_per_episode

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "temperature"

    @property
    def hidden(self) -> tuple[int, ...]:
        """Units of the hidden layers, first to last."""
        return (self.hidden_units,) * self.hidden_layers

    @property
    def copies(self) -> int:
        """Experiences stored for each step: one for the flight's own goal, the others in hindsight."""
        return 1 + self.hindsight_ratio

    @property
    def experience_bytes(self) -> int:
        """Memory of one experience with all that is kept beside it."""
        return EXPERIENCE_BYTES

    def check_fits(self, task: Task, grid: Grid, n_seeds: int = 1) -> None:
        """`InputError` before anything is compiled if the replay memory cannot hold a flight.

        The same if the replay memories of all seeds are larger than the memory there is.
        """
        rows = task.max_steps * self.copies
        if rows > self.replay_capacity:
            raise InputError(
                f"replay_capacity is {self.replay_capacity}, but one flight can store {rows} experiences "
                f"({task.max_steps} steps x {self.copies}): raise replay_capacity or lower max_steps"
            )
        of_seeds = f" for each of {n_seeds} seeds" if n_seeds > 1 else ""
        check_memory(
            n_seeds * self.replay_capacity * self.experience_bytes,
            f"a replay memory of {self.replay_capacity:,} experiences{of_seeds}",
            "lower replay_capacity" + " or train fewer seeds at once" * (n_seeds > 1),
        )

    def learner(self, place: "Place") -> "Learner":
        """Algorithms 1 and 2 of the thesis."""
        from cellpilot.learn.algorithms.ddqn_her import ALGORITHM
        from cellpilot.learn.compiled import CompiledLearner

        return CompiledLearner(ALGORITHM, self, place)


class DDQNHERVariants(DDQNHER):
    """DDQN-HER with switches: what section 5.4 takes away, what the literature adds; by default the published one."""

    algorithm: Literal["ddqn-her-variants"] = Field("ddqn-her-variants", description=ALGORITHM_HELP)  # type: ignore[assignment]
    exploration: Exploration = Field("boltzmann", description="exploration (section 3.1.6)")
    hindsight: bool = Field(True, description="hindsight experience replay on or off (section 5.4)")
    hindsight_strategy: Strategy = Field("future", description="hindsight goals (section 3.3.4)")
    double: bool = Field(True, description="double Q-learning on or off (section 5.4)")
    clip_targets: bool = Field(True, description="clip targets to what a flight can earn (ours: without it some seeds diverge)")
    architecture: Architecture = Field("concatenated", description="value network (section 3.3.3; dueling: Wang et al. 2016)")
    n_steps: Count = Field(1, le=100, description="steps of the return in a target (Sutton 1988; thesis: 1)")
    prioritised: bool = Field(False, description="prioritised replay, proportional, on or off (Schaul et al. 2016; thesis: off)")
    priority_exponent: float = Field(0.6, gt=0, le=1, description="exponent of priorities, alpha (Schaul et al. 2016)")
    importance_exponent: float = Field(
        0.4, ge=0, le=1, description="first exponent of the importance weights, beta; the last is 1 (Schaul et al. 2016)"
    )
    networks: Count = Field(1, le=2, description="networks; of 2 the smaller value makes the target (Fujimoto et al. 2018)")

    @model_validator(mode="after")
    def _epsilon_fits(self) -> "DDQNHERVariants":
        if self.exploration == "epsilon-greedy" and max(self.initial_exploration, self.final_exploration) > 1:
            raise ValueError("epsilon-greedy needs initial_exploration and final_exploration between 0 and 1")
        return self

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "temperature" if self.exploration == "boltzmann" else "epsilon"

    @property
    def hindsight_goals(self) -> int:
        """Hindsight goals of each step: none with hindsight off."""
        return self.hindsight_ratio if self.hindsight else 0

    @property
    def copies(self) -> int:
        """Experiences stored for each step: one for the flight's own goal, the others in hindsight."""
        return 1 + self.hindsight_goals

    @property
    def experience_bytes(self) -> int:
        """Memory of one experience with all that is kept beside it."""
        return EXPERIENCE_BYTES + STEPS_LEFT_BYTES * (self.n_steps > 1) + PRIORITY_BYTES * self.prioritised

    def learner(self, place: "Place") -> "Learner":
        """The published algorithm with what the switches say."""
        from cellpilot.learn.algorithms.ddqn_her_variants import ALGORITHM
        from cellpilot.learn.compiled import CompiledLearner

        return CompiledLearner(ALGORITHM, self, place)
