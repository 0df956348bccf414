"""What the settings of every learner offer. No JAX here: settings are checked before anything slow is imported."""

from abc import ABC, abstractmethod
from typing import TYPE_CHECKING, ClassVar

from cellpilot.grid import Grid
from cellpilot.settings import Settings
from cellpilot.task import Task

if TYPE_CHECKING:
    from cellpilot.learn.learner import Learner, Place

ALGORITHM_HELP = (
    "ddqn-her (as published), ddqn-her-variants (with its switches), fqi-her (near-exact) or map-learner (plans on a map that it"
    " learns); given with --help, the settings shown are its own"
)


class LearnerSettings(Settings, ABC):
    """Settings of one algorithm: its subclass has a field `algorithm`, the name by which it is chosen, and fields of its own.

    A round is whatever the algorithm repeats: an episode with its updates, or a step of many parallel flights with its updates.
    """

    counts: ClassVar[str]  # what a round is called in the plural: episodes, rounds, flights
    chunk_rounds: ClassVar[int]  # rounds between two looks at progress, interruption and the clock; changes no result
    depends_on_cores: ClassVar[bool] = False  # whether another number of cores gives another result
    algorithm: str

    @property
    @abstractmethod
    def n_rounds(self) -> int:
        """Rounds of the whole training."""

    @property
    @abstractmethod
    def updates(self) -> int:
        """Optimization steps of the whole training."""

    @property
    @abstractmethod
    def explores_by(self) -> str:
        """What `exploration_at` of the learner returns: temperature, epsilon."""

    def check_fits(self, task: Task, grid: Grid, n_seeds: int = 1) -> None:
        """`InputError` before anything slow is imported if this learner cannot be trained so, `n_seeds` seeds at once."""

    @abstractmethod
    def learner(self, place: "Place") -> "Learner":
        """The learner with these settings at a place."""
