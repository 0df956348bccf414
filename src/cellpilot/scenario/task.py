"""What a flight earns and when it ends, and how policies that fly are compared."""

from typing import Annotated, Literal

from pydantic import Field

from cellpilot.airspace import Rule
from cellpilot.settings import Cell, Finite, NonNegative, Positive, Settings


class RewardSettings(Settings):
    """What a flight earns and when it ends (section 4.2.2)."""

    rho_goal: Finite = Field(10.0, description="reward for reaching the goal (Table 4.2)")
    rho_sinr: Finite = Field(-1.0, description="reward of a step below the threshold (Table 4.2)")
    rho_step: Finite = Field(-0.1, description="reward of every step (Table 4.2)")
    rho_blocked: Finite = Field(0.0, description="reward of a move that a blocked cell stops")
    rho_end: Finite = Field(-100.0, description="reward of a flight that ends in a blocked cell (rule end; section 7.2)")
    threshold_db: Finite = Field(3.0, description="SINR threshold [dB] (section 4.4.2)")
    noise_std_db: NonNegative = Field(
        0.0, description="standard deviation of the noise drawn at every step [dB] (section 5.2: 2)"
    )
    discount: float = Field(0.995, gt=0, le=1, description="discount factor (Table 4.3)")
    max_steps: Annotated[int, Field(ge=1, le=10_000_000)] | None = Field(
        None, description="cap on steps; None = ten times the sum of the sides (section 4.2.2: 400, 450)"
    )


class AirspaceSettings(Settings):
    """How the drone moves, and what a move does that is forbidden."""

    moves: Literal[4, 6, 8, 26] | None = Field(
        None, description="move set: 4 or 6 along the axes, 8 or 26 with diagonals; None = 4 on one height, 6 on several"
    )
    rule: Rule = Field(
        "stay", description="a move into a blocked cell stays in place, is not offered (mask), or ends the flight (section 7.2)"
    )


class TaskSettings(RewardSettings):
    """What a flight earns, when it ends and between which cells it leads (section 4.2.2)."""

    start: Cell | None = Field(None, description="fixed start IX IY IZ; None = drawn uniformly")
    goal: Cell | None = Field(None, description="fixed goal IX IY IZ; None = drawn uniformly")


class EvaluationSettings(Settings):
    """How policies are compared (section 4.4)."""

    n_sampled: Annotated[int, Field(ge=1, le=10_000_000)] = Field(10_000, description="sampled flights (section 4.4)")
    seed: int = Field(0, ge=0, lt=2**63, description="seed of instances and noise")
    boltzmann_temperature: Annotated[float, Field(gt=0, le=1e6)] = Field(
        0.1, description="temperature of the stochastic learned policy"
    )
    max_exhaustive_pairs: Annotated[int, Field(ge=0)] = Field(5_000_000, description="fly all pairs exactly below this number")
    speed_mps: Positive = Field(10.0, description="planned speed, for outages in seconds and handovers [m/s]")
    hysteresis_db: NonNegative = Field(3.0, description="a handover needs a sector stronger by this [dB] (event A3)")
    time_to_trigger_s: NonNegative = Field(0.256, description="... for so long [s] (event A3)")
