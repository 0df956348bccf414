"""What the trainer asks of an algorithm's settings. No JAX here: settings are checked before anything slow is imported."""

from typing import ClassVar, Protocol, runtime_checkable

from cellpilot.task import Task


@runtime_checkable
class AlgorithmSettings(Protocol):
    """A frozen dataclass of settings; its fields beyond these are the algorithm's own business."""

    algorithm: ClassVar[str]  # its line in `table.ALGORITHMS`
    counts: ClassVar[str]  # what a round is called in the plural: episodes, rounds
    chunk_rounds: ClassVar[int]  # rounds between two looks at progress, interruption and the clock; changes no result

    @property
    def rounds(self) -> int:
        """Rounds of the whole training."""

    @property
    def updates(self) -> int:
        """Optimisation steps of the whole training."""

    @property
    def explores_by(self) -> str:
        """What `exploration_at` returns: temperature, epsilon."""

    def check_fits(self, task: Task, n_seeds: int = 1) -> None:
        """`InputError` before anything is compiled if these settings cannot be trained on the task, that many seeds at once."""
