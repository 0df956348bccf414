"""Settings of the map learner. No JAX here: they are checked before anything slow is imported."""

from typing import TYPE_CHECKING, Annotated, ClassVar, Literal

from pydantic import Field, Strict

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.base import ALGORITHM_HELP, LearnerSettings
from cellpilot.settings import Count, NonNegative
from cellpilot.task import Task

if TYPE_CHECKING:
    from cellpilot.learn.learner import Learner, Place

Counts = Annotated[tuple[Count, ...], Strict(False)]
MOST_LEARNED_CELLS = 3_000
"""Larger maps are refused: the posterior would hold more than 9 million covariances for each seed."""


class MapLearning(LearnerSettings):
    """The map learner: it estimates the radio map from what it measures, and plans exactly on that (docs/map_learner.md)."""

    counts: ClassVar[str] = "flights"
    chunk_rounds: ClassVar[int] = 1

    algorithm: Literal["map-learner"] = Field("map-learner", description=ALGORITHM_HELP)
    flights: Count = Field(80, description="flights from which the map is learned")
    exploration: Literal["optimism", "thompson"] = Field(
        "optimism", description="plan on an optimistic map, or on one that is drawn from what is known (Thompson sampling)"
    )
    optimism: NonNegative = Field(1.0, description="standard deviations that the optimistic map lies above the mean")
    replan_every_steps: int = Field(1, ge=0, description="measurements between two plans of one flight; 0 = one plan per flight")
    estimate_after_flights: Counts = Field(
        (3, 5, 10, 20, 40, 80), description="flights after which spread, correlation lengths and noise are estimated again"
    )
    prior_slope_std: NonNegative = Field(
        0.5, description="how far from 1 the true multiple of a prior map's pattern may be (without effect without such a map)"
    )
    discount: float = Field(1.0, gt=0, le=1, description="discount of the plans; 1 = the undiscounted return, the measure of all")

    @property
    def n_rounds(self) -> int:
        """A round is one flight."""
        return self.flights

    @property
    def updates(self) -> int:
        """None: nothing is optimized by gradients."""
        return 0

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "optimism" if self.exploration == "optimism" else "drawn maps"

    def check_fits(self, task: Task, grid: Grid, n_seeds: int = 1) -> None:
        """`InputError` for a grid that is too large, or a reward that a policy file cannot hold."""
        if grid.n_cells > MOST_LEARNED_CELLS:
            raise InputError(
                f"map-learner can hold {MOST_LEARNED_CELLS:,} cells, the map has {grid.n_cells:,}:"
                " use larger bins, a part, or fqi-her"
            )
        if task.more:
            raise InputError(
                f"map-learner cannot train with the reward {task.more[0].name!r}: its policy plans where it flies, and a file"
                " holds no function; use ddqn-her"
            )

    def learner(self, place: "Place") -> "Learner":
        """Flights that learn a map."""
        from cellpilot.learn.algorithms.map_learner_run import map_learner_at

        return map_learner_at(self, place)
