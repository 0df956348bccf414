"""Settings of FQI-HER. No JAX here: they are checked before anything slow is imported."""

from typing import TYPE_CHECKING, ClassVar, Literal

from pydantic import Field, model_validator

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.base import ALGORITHM_HELP, LearnerSettings
from cellpilot.memory import check_memory
from cellpilot.policies.pair_value import Sides, n_rows
from cellpilot.settings import Count, NonNegative, Positive
from cellpilot.task import Task

if TYPE_CHECKING:
    from cellpilot.learn.learner import Learner, Place

TARGET_BYTES = 9
"""Of one cell in a column of the cache of targets: two floats of four bytes and one flag."""
TABLES = 4
"""Of equal size: the network that is fitted, its average, and the two moments of Adam."""


class FQIHER(LearnerSettings):
    """The near-exact learner FQI-HER: fitted Q-iteration over pairs of cells (docs/learning.md)."""

    counts: ClassVar[str] = "rounds"
    chunk_rounds: ClassVar[int] = 5
    depends_on_cores: ClassVar[bool] = True  # among which the compiler divides its sums

    algorithm: Literal["fqi-her"] = Field("fqi-her", description=ALGORITHM_HELP)
    rounds: Count = Field(300, description="rounds; in each all flights fly some steps, then the network is fitted")
    flights: Count = Field(64, description="flights in the air at a time")
    steps_per_round: Count = Field(15, description="steps of each flight in a round")
    updates_per_round: Count = Field(40, description="optimization steps in a round")
    batch_size: Count = Field(2048, description="pairs of cell and goal in a mini-batch")
    goals_per_round: Count = Field(64, description="hindsight goals whose targets are computed in a round")
    sweeps: Count = Field(8, description="value-iteration sweeps per target before bootstrapping from the network")
    penalty_model: bool = Field(True, description="estimate each cell's outage probability (model-based); off: model-free")
    look_ahead: Count = Field(8, description="moves the policy looks ahead through the penalty model before its network")
    prioritised: float = Field(0.4, ge=0, le=1, description="share of a mini-batch drawn in proportion to its error")
    near: float = Field(0.3, ge=0, le=1, description="share of a mini-batch drawn from cells near the goal")
    near_cells: Count = Field(6, description="how near: at most so many cells away along each axis")
    cached_goals: Count = Field(2000, description="goals whose targets are kept for fitting, the oldest renewed first")
    networks: Count = Field(1, le=8, description="networks of which the least value counts (2 = clipped double Q)")
    hidden_units: Count = Field(64, description="units of the hidden layers")
    learning_rate: Positive = Field(1e-2, description="learning rate of Adam in the first round")
    final_learning_rate: Positive = Field(1e-4, description="learning rate of Adam in the last round, by half a cosine")
    averaging: float = Field(0.02, gt=0, le=1, description="share of the new weights in the averaged network at each update")
    initial_exploration: NonNegative = Field(1.0, description="initial temperature")
    final_exploration: NonNegative = Field(0.1, description="final temperature")
    exploration_fraction: float = Field(0.5, gt=0, le=1, description="share of rounds of the descent")
    count_bonus: NonNegative = Field(100.0, description="bonus of entering a cell, over the root of how often it was measured")
    stored_per_cell: Count = Field(32, description="measurements of each cell kept for replay (model-free)")

    @model_validator(mode="after")
    def _consistent(self) -> "FQIHER":
        if self.prioritised + self.near > 1:
            raise ValueError(f"prioritised {self.prioritised:g} and near {self.near:g} add up to more than 1; lower one")
        if not self.penalty_model and self.look_ahead > 1:
            raise ValueError(
                f"look_ahead is {self.look_ahead}, but look-ahead needs the penalty model."
                " Set look_ahead = 1 or penalty_model = true."
            )
        return self

    @property
    def n_rounds(self) -> int:
        """Rounds of the whole training."""
        return self.rounds

    @property
    def updates(self) -> int:
        """Optimization steps of the whole training."""
        return self.rounds * self.updates_per_round

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "temperature"

    def check_fits(self, task: Task, grid: Grid, n_seeds: int = 1) -> None:
        """`InputError` for rewards under which the distance to the goal does not bound the value from above.

        The same for a look-ahead that is too long for the grid, and for more memory than there is.
        """
        if task.more:
            raise InputError(
                f"fqi-her cannot train with the reward {task.more[0].name!r}: its policy computes rewards where it flies, and a"
                " file holds no function; use ddqn-her"
            )
        penalties = (task.rho_sinr, task.rho_blocked, task.rho_end)
        if not (task.rho_goal >= 0 and task.rho_step < 0 and max(penalties) <= 0):
            found = ", ".join(f"{reward:g}" for reward in (task.rho_goal, task.rho_step, *penalties))
            raise InputError(
                "fqi-her needs rho_goal >= 0, rho_step < 0 and rho_sinr, rho_blocked, rho_end <= 0, since it bounds values by"
                f" the distance to the goal; found {found}: change the rewards or use ddqn-her"
            )
        if self.look_ahead > (most := 10 * sum(grid.sides)):
            raise InputError(f"look_ahead is {self.look_ahead}; expected at most {most}, ten times the sides of this grid")
        self.check_memory_fits(grid.sides, n_seeds)

    def kept_bytes(self, sides: Sides) -> int:
        """Memory of the cached targets and of the tables of all networks, for one seed."""
        n_cells = sides[0] * sides[1] * sides[2]
        targets = min(self.cached_goals, n_cells) * n_cells * TARGET_BYTES
        return targets + TABLES * self.networks * n_rows(sides) * self.hidden_units * 4

    def check_memory_fits(self, sides: Sides, n_seeds: int = 1) -> None:
        """`InputError` before anything is compiled if what all seeds keep on this grid is larger than the memory there is."""
        of_seeds = f" for each of {n_seeds} seeds" if n_seeds > 1 else ""
        n_cells = sides[0] * sides[1] * sides[2]
        check_memory(
            n_seeds * self.kept_bytes(sides),
            f"fqi-her on {n_cells:,} cells, with targets of {min(self.cached_goals, n_cells):,} goals{of_seeds},",
            "lower cached_goals or hidden_units" + ", train fewer seeds at once" * (n_seeds > 1) + ", or take larger cells",
        )

    def learner(self, place: "Place") -> "Learner":
        """Fitted Q-iteration over pairs of cells."""
        from cellpilot.learn.algorithms.fqi_her import ALGORITHM
        from cellpilot.learn.compiled import CompiledLearner

        return CompiledLearner(ALGORITHM, self, place)
