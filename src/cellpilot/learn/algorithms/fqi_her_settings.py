"""Settings of FQI-HER as compiled code needs them. No JAX here: they are checked before anything slow is imported."""

from dataclasses import dataclass
from typing import ClassVar

from cellpilot.errors import InputError
from cellpilot.memory import check_memory
from cellpilot.policies.pair_value import Sides, n_rows
from cellpilot.task import Task

TARGET_BYTES = 9
"""Of one cell in a column of the cache of targets: two floats of four bytes and one flag."""
TABLES = 4
"""Of equal size: the network that is fitted, its average, and the two moments of Adam."""


@dataclass(frozen=True)
class FQIHER:
    """Settings as compiled code needs them; `scenario.PairLearnerSettings` documents each and takes its default from here."""

    algorithm: ClassVar[str] = "fqi-her"
    counts: ClassVar[str] = "rounds"
    chunk_rounds: ClassVar[int] = 5

    rounds: int = 300
    flights: int = 64
    steps_per_round: int = 15
    updates_per_round: int = 40
    batch_size: int = 2048
    goals_per_round: int = 64
    sweeps: int = 8
    look_ahead: int = 8
    penalty_model: bool = True
    prioritised: float = 0.4
    near: float = 0.3
    near_cells: int = 6
    cached_goals: int = 2000
    networks: int = 1
    hidden_units: int = 64
    learning_rate: float = 1e-2
    final_learning_rate: float = 1e-4
    averaging: float = 0.02
    initial_exploration: float = 1.0
    final_exploration: float = 0.1
    exploration_fraction: float = 0.5
    count_bonus: float = 100.0
    stored_per_cell: int = 32

    @property
    def updates(self) -> int:
        """Optimisation steps of the whole training."""
        return self.rounds * self.updates_per_round

    @property
    def explores_by(self) -> str:
        """Name of the quantity that `exploration_at` returns."""
        return "temperature"

    def check_fits(self, task: Task, n_seeds: int = 1) -> None:
        """`InputError` for rewards under which the distance to the goal does not bound the value from above."""
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
