"""What a flight earns and when it ends, and how policies that fly are compared."""

from typing import Annotated, Literal

from pydantic import Field

from cellpilot.airspace import USUAL_RULE, Rule
from cellpilot.evaluate.evaluation import MAX_EXHAUSTIVE_PAIRS, N_SAMPLED
from cellpilot.evaluate.mobility import HandoverRule
from cellpilot.settings import Cell, Finite, NonNegative, Settings
from cellpilot.signal import NO_NOISE_DB
from cellpilot.task import Task


class RewardSettings(Settings):
    """What a flight earns and when it ends (section 4.2.2)."""

    rho_goal: Finite = Field(Task.rho_goal, description="reward for reaching the goal (Table 4.2)")
    rho_sinr: Finite = Field(Task.rho_sinr, description="reward of a step below the threshold (Table 4.2)")
    rho_step: Finite = Field(Task.rho_step, description="reward of every step (Table 4.2)")
    rho_blocked: Finite = Field(Task.rho_blocked, description="reward of a move that a blocked cell stops")
    rho_end: Finite = Field(Task.rho_end, description="reward of a flight that ends in a blocked cell (rule end; section 7.2)")
    threshold_db: Finite = Field(Task.threshold_db, description="SINR threshold [dB] (section 4.4.2)")
    noise_std_db: NonNegative = Field(
        NO_NOISE_DB, description="standard deviation of the noise drawn at every step [dB] (section 5.2: 2)"
    )
    discount: float = Field(Task.discount, gt=0, le=1, description="discount factor (Table 4.3)")
    max_steps: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        None, description="cap on steps; None = ten times the sum of the sides (section 4.2.2: 400, 450)"
    )


class AirspaceSettings(Settings):
    """How the drone moves, and what a move does that is forbidden."""

    moves: Literal[4, 6, 8, 26] | None = Field(
        None, description="move set: 4 or 6 along the axes, 8 or 26 with diagonals; None = 4 on one height, 6 on several"
    )
    rule: Rule = Field(
        USUAL_RULE,
        description="a move into a blocked cell stays in place, is not offered (mask), or ends the flight (section 7.2)",
    )


class TaskSettings(RewardSettings):
    """What a flight earns, when it ends and between which cells it leads (section 4.2.2)."""

    start: Cell | None = Field(None, description="fixed start IX IY IZ; None = drawn uniformly")
    goal: Cell | None = Field(None, description="fixed goal IX IY IZ; None = drawn uniformly")


class EvaluationSettings(HandoverRule):
    """How policies are compared (section 4.4)."""

    n_sampled: Annotated[int, Field(ge=1, le=10_000_000)] = Field(N_SAMPLED, description="sampled flights (section 4.4)")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of instances and noise")
    boltzmann_temperature: Annotated[float, Field(gt=0, le=1e6)] = Field(
        0.1, description="temperature of the stochastic learned policy"
    )
    max_exhaustive_pairs: Annotated[int, Field(ge=0)] = Field(
        MAX_EXHAUSTIVE_PAIRS, description="fly all pairs exactly below this number"
    )
