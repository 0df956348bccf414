"""Settings of the learners, each with the defaults of its algorithm."""

from typing import Literal

from pydantic import Field, model_validator

from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.settings import Count, NonNegative, Positive, Settings

ALGORITHM_HELP = "ddqn-her (as published) or fqi-her (near-exact); given with --help, the settings shown are its own"


class LearnerSettings(Settings):
    """The published learner DDQN-HER (section 4.3)."""

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
    exploration: Literal["boltzmann", "epsilon-greedy"] = Field("boltzmann", description="exploration (section 3.1.6)")
    initial_exploration: NonNegative = Field(2.0, description="initial temperature, or epsilon (Table 4.3)")
    final_exploration: NonNegative = Field(0.1, description="final temperature, or epsilon (Table 4.3)")
    exploration_fraction: float = Field(0.5, gt=0, le=1, description="share of episodes of the descent (Table 4.3: 0.5, 3D 0.7)")
    hindsight: bool = Field(True, description="hindsight experience replay on or off (section 5.4)")
    hindsight_ratio: Count = Field(2, description="hindsight goals stored beside each own experience, k (Table 4.3)")
    hindsight_strategy: Literal["future", "final", "episode"] = Field("future", description="hindsight goals (section 3.3.4)")
    double: bool = Field(True, description="double Q-learning on or off (section 5.4)")
    clip_targets: bool = Field(True, description="clip targets to what a flight can earn (ours: without it some seeds diverge)")
    architecture: Literal["concatenated", "two-stream", "dueling"] = Field(
        "concatenated", description="value network (section 3.3.3; dueling: Wang et al. 2016)"
    )
    hidden_layers: Count = Field(3, description="hidden layers (section 4.3)")
    hidden_units: Count = Field(50, description="units of each hidden layer (section 4.3)")
    n_steps: Count = Field(1, le=100, description="steps of the return in a target (Sutton 1988; thesis: 1)")
    prioritised: bool = Field(False, description="prioritised replay, proportional, on or off (Schaul et al. 2016; thesis: off)")
    priority_exponent: float = Field(0.6, gt=0, le=1, description="exponent of priorities, alpha (Schaul et al. 2016)")
    importance_exponent: float = Field(
        0.4, ge=0, le=1, description="first exponent of the importance weights, beta; the last is 1 (Schaul et al. 2016)"
    )
    networks: Count = Field(1, le=2, description="networks; of 2 the smaller value makes the target (Fujimoto et al. 2018)")

    @model_validator(mode="after")
    def _consistent(self) -> "LearnerSettings":
        if self.replay_start > self.replay_capacity:
            raise ValueError(f"replay_start {self.replay_start} is larger than replay_capacity {self.replay_capacity}; lower it")
        if self.exploration == "epsilon-greedy" and max(self.initial_exploration, self.final_exploration) > 1:
            raise ValueError("epsilon-greedy needs initial_exploration and final_exploration between 0 and 1")
        return self


class PairLearnerSettings(Settings):
    """The near-exact learner FQI-HER: fitted Q-iteration over pairs of cells (docs/learning.md)."""

    algorithm: Literal["fqi-her"] = Field("fqi-her", description=ALGORITHM_HELP)
    rounds: Count = Field(FQIHER.rounds, description="rounds; in each all flights fly some steps, then the network is fitted")
    flights: Count = Field(FQIHER.flights, description="flights in the air at a time")
    steps_per_round: Count = Field(FQIHER.steps_per_round, description="steps of each flight in a round")
    updates_per_round: Count = Field(FQIHER.updates_per_round, description="optimization steps in a round")
    batch_size: Count = Field(FQIHER.batch_size, description="pairs of cell and goal in a mini-batch")
    goals_per_round: Count = Field(FQIHER.goals_per_round, description="hindsight goals whose targets are computed in a round")
    sweeps: Count = Field(
        FQIHER.sweeps, description="known moves with the learned penalty before the network takes over in a target"
    )
    penalty_model: bool = Field(FQIHER.penalty_model, description="learn the chance of low signal per cell; off = model-free")
    look_ahead: Count = Field(
        FQIHER.look_ahead, description="moves the policy looks ahead through the penalty model before its network"
    )
    prioritised: float = Field(
        FQIHER.prioritised, ge=0, le=1, description="share of a mini-batch drawn in proportion to its error"
    )
    near: float = Field(FQIHER.near, ge=0, le=1, description="share of a mini-batch drawn from cells near the goal")
    near_cells: Count = Field(FQIHER.near_cells, description="how near: at most so many cells away along each axis")
    cached_goals: Count = Field(
        FQIHER.cached_goals, description="goals whose targets are kept for fitting, the oldest renewed first"
    )
    networks: Count = Field(FQIHER.networks, le=8, description="networks of which the least value counts (2 = clipped double Q)")
    hidden_units: Count = Field(FQIHER.hidden_units, description="units of the hidden layers")
    learning_rate: Positive = Field(FQIHER.learning_rate, description="learning rate of Adam in the first round")
    final_learning_rate: Positive = Field(
        FQIHER.final_learning_rate, description="learning rate of Adam in the last round, by half a cosine"
    )
    averaging: float = Field(
        FQIHER.averaging, gt=0, le=1, description="share of the new weights in the averaged network at each update"
    )
    initial_exploration: NonNegative = Field(FQIHER.initial_exploration, description="initial temperature")
    final_exploration: NonNegative = Field(FQIHER.final_exploration, description="final temperature")
    exploration_fraction: float = Field(FQIHER.exploration_fraction, gt=0, le=1, description="share of rounds of the descent")
    count_bonus: NonNegative = Field(
        FQIHER.count_bonus, description="bonus of entering a cell, over the root of how often it was measured"
    )
    stored_per_cell: Count = Field(FQIHER.stored_per_cell, description="measurements of each cell kept for replay (model-free)")

    @model_validator(mode="after")
    def _consistent(self) -> "PairLearnerSettings":
        if self.prioritised + self.near > 1:
            raise ValueError(f"prioritised {self.prioritised:g} and near {self.near:g} add up to more than 1; lower one")
        if not self.penalty_model and self.look_ahead > 1:
            raise ValueError(f"without penalty_model no move can be looked through; set look_ahead, now {self.look_ahead}, to 1")
        return self


AnyLearnerSettings = LearnerSettings | PairLearnerSettings
LEARNERS: dict[str, type[LearnerSettings] | type[PairLearnerSettings]] = {
    "ddqn-her": LearnerSettings,
    "fqi-her": PairLearnerSettings,
}
"""Settings by the name of the algorithm."""
