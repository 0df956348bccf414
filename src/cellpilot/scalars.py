"""Scalars for TensorBoard (extra `tb`): the learning curve while it grows, and the final evaluation.

A run that is logged has a folder `tensorboard` in its run folder, so `tensorboard --logdir runs` compares all runs, and a
resumed run goes on logging without being asked again.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, closing, contextmanager
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.learn.history import mean_of_flights

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress

FOLDER = "tensorboard"
TAGS = {
    "episode_return": "train/return",
    "n_steps": "train/steps",
    "reached": "train/reached",
    "exploration": "train/exploration",
}
"""Names in TensorBoard of the columns of a learning curve."""


def require_writer() -> None:
    """`InputError` if the extra is missing."""
    if find_spec("tensorboardX") is None:
        raise InputError("TensorBoard scalars need the extra tb: pip install 'cellpilot[tb]'")


def ask_for_log(run_folder: Path) -> None:
    """Have a run logged from now on; `InputError` if the extra is missing."""
    require_writer()
    (run_folder / FOLDER).mkdir(exist_ok=True)


def is_logged(run_folder: Path) -> bool:
    """Whether a run asks to be logged; `InputError` if it does and the extra is missing."""
    logged = (run_folder / FOLDER).is_dir()
    if logged:
        require_writer()
    return logged


class ScalarLog:
    """The learning curve of a run in one event file, and the figures of its evaluation in another.

    Each takes the place of an earlier one: a file of a training that was cut off may lack points that were still on their way
    to the disk, and holds others that are trained again, while the checkpoint has the whole curve.
    """

    def __init__(self, run_folder: Path):
        self._folder = run_folder / FOLDER
        self._writers: dict[str, Any] = {}
        self._rounds = 0

    def add_history(self, history: Mapping[str, np.ndarray], rows: int) -> None:
        """Write what is new of a learning curve (columns `[rounds]`): the mean of every `rows` rounds, at the last of them.

        Rounds in which no flight ended have no mean.
        """
        n = len(history["episode_return"])
        while self._rounds < n:
            first, self._rounds = self._rounds, min(self._rounds + rows, n)
            rounds = slice(first, self._rounds)
            means = {tag: mean_of_flights(history, column, rounds) for column, tag in TAGS.items() if column in history}
            self._add("curve", means, self._rounds)

    def add_evaluation(self, policies: Mapping[str, Mapping[str, Any]], step: int) -> None:
        """Write the figures of every policy (`runs.payload(...)["policies"]`); those without a value are left out."""
        for policy, figures in policies.items():
            numbers = {name: value for name, value in figures.items() if isinstance(value, int | float)}
            self._add("evaluation", {f"evaluation/{name}/{policy}": float(value) for name, value in numbers.items()}, step)

    def close(self) -> None:
        """Finish the files."""
        for writer in self._writers.values():
            writer.close()

    def _add(self, part: str, values: Mapping[str, float], step: int) -> None:
        if part not in self._writers:
            from tensorboardX import SummaryWriter

            for file in self._folder.glob(f"events.*.{part}"):
                file.unlink()
            self._writers[part] = SummaryWriter(str(self._folder), filename_suffix=f".{part}")
        for tag, value in values.items():
            if np.isfinite(value):
                self._writers[part].add_scalar(tag, value, step)
        self._writers[part].flush()


@contextmanager
def logged_progress(run_folders: Sequence[Path], rows: int) -> "Iterator[Callable[[TrainingProgress], None]]":
    """A progress callback that writes the curve of each run that asks for it, the mean of every `rows` rounds."""
    with ExitStack() as stack:
        logs = [stack.enter_context(closing(ScalarLog(folder))) if is_logged(folder) else None for folder in run_folders]

        def write(progress: "TrainingProgress") -> None:
            histories = progress.histories() if any(logs) else [{}] * len(logs)
            for log, history in zip(logs, histories, strict=True):
                if log is not None:
                    log.add_history(history, rows)

        yield write


def log_evaluation(run_folder: Path, policies: Mapping[str, Mapping[str, Any]], step: int) -> None:
    """Write the figures of an evaluation if the run asks for it."""
    if is_logged(run_folder):
        with closing(ScalarLog(run_folder)) as log:
            log.add_evaluation(policies, step)
