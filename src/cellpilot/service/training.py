"""Training a scenario over seeds, each in a run folder, and going on with it."""

from collections.abc import Callable, Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellpilot.errors import InputError
from cellpilot.experiment import divergence_warning, threshold_warning
from cellpilot.provenance import usable_cores
from cellpilot.runs import Run, create_run, is_occupied, open_run, read_facts, train_runs
from cellpilot.scenario import Scenario, find_scenario, load_scenario
from cellpilot.service.callbacks import Warn, as_warning, tell
from cellpilot.storage import hold

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress, TrainingResult

    TellTraining = Callable[[TrainingProgress], None]

BY_SERVICE = "cellpilot.service.train"
SEED_0 = (0,)


@dataclass(frozen=True)
class Trained:
    """Runs, one for each seed, and how their training went."""

    runs: "list[Run]"
    results: "list[TrainingResult]"

    @property
    def finished(self) -> bool:
        """Whether none was interrupted; `resume` goes on with what was."""
        return all(result.finished for result in self.results)


def train(
    scenario: Scenario | str | Path,
    out: str | Path | None = None,
    *,
    seeds: Sequence[int] = SEED_0,
    force: bool = False,
    progress: "TellTraining" = lambda progress: None,
    warn: Warn = as_warning,
) -> Trained:
    """Make the map, a run folder for each seed, and train all seeds together.

    `scenario`: settings, TOML file or shipped name. `out`: the folder; with several seeds each has `OUT-seedK`; default
    `runs/NAME-seedK`. `force` replaces runs that are there. `progress` hears a `TrainingProgress` after each chunk.
    `InputError` names the argument or setting that cannot be used.
    """
    settings = scenario if isinstance(scenario, Scenario) else load_scenario(find_scenario(str(scenario)))
    with started(settings, out, seeds, BY_SERVICE, force=force, warn=warn) as runs:
        return Trained(runs, train_held(runs, progress, warn))


def resume(
    folders: str | Path | Sequence[str | Path],
    *,
    progress: "TellTraining" = lambda progress: None,
    warn: Warn = as_warning,
) -> Trained:
    """Go on with the trainings in one or more run folders, with their own settings and seeds; all at once."""
    with resumed([folders] if isinstance(folders, str | Path) else folders, warn) as runs:
        return Trained(runs, train_held(runs, progress, warn))


def run_folders(name: str, out: str | Path | None, seeds: Sequence[int]) -> list[Path]:
    """The run folder of each seed."""
    if out is not None and len(seeds) == 1:
        return [Path(out)]
    base = Path("runs") / name if out is None else Path(out)
    return [base.with_name(f"{base.name}-seed{seed}") for seed in seeds]


@contextmanager
def started(
    scenario: Scenario,
    out: str | Path | None,
    seeds: Sequence[int],
    command: str,
    *,
    force: bool = False,
    warn: Warn = as_warning,
) -> "Iterator[list[Run]]":
    """New runs, one for each seed, held until the end; `InputError` where a folder is in use or not empty."""
    if not isinstance(seeds, Sequence) or not seeds or not all(type(seed) is int and 0 <= seed < 2**31 for seed in seeds):
        raise InputError(f"`seeds` is {seeds!r}; expected whole numbers from 0 to {2**31 - 1}, such as (0, 1, 2)")
    if len(set(seeds)) < len(seeds):
        raise InputError(f"`seeds` are {', '.join(map(str, seeds))}; expected different ones")
    folders = run_folders(scenario.name, out, seeds)
    with ExitStack() as held:
        for folder in folders:
            held.enter_context(hold(folder))
            is_occupied(folder, force)
        runs = [
            create_run(folder, scenario, seed, command, force, len(seeds)) for folder, seed in zip(folders, seeds, strict=True)
        ]
        tell(warn, threshold_warning(runs[0].world, runs[0].task.threshold_db))
        yield runs


@contextmanager
def resumed(folders: Sequence[str | Path], warn: Warn = as_warning) -> "Iterator[list[Run]]":
    """Runs that are there, held until the end."""
    if not folders:
        raise InputError("`resume`: expected the folder of a run, found none")
    with ExitStack() as held:
        for folder in map(Path, folders):
            if folder.is_dir():
                held.enter_context(hold(folder))
        runs = [open_run(folder) for folder in folders]
        tell(warn, _cores_warning(runs))
        yield runs


def train_held(
    runs: Sequence[Run],
    progress: "TellTraining" = lambda progress: None,
    warn: Warn = as_warning,
    noticed: Callable[[], None] = lambda: None,
) -> "list[TrainingResult]":
    """Train runs that are held, and warn of values that have diverged; `noticed` hears that an interrupt was."""
    results = train_runs(runs, progress, noticed)
    for run, result in zip(runs, results, strict=True):
        parameters = run.parameters() if result.finished else None
        if parameters is not None:
            tell(warn, divergence_warning(parameters, run.world, run.task))
    return results


def _cores_warning(runs: Sequence[Run]) -> str | None:
    """What to say where a training goes on with another number of cores, and so to another result; None where it does not."""
    began = {cores for run in runs if (cores := read_facts(run.folder).cores) is not None}
    if not began - {usable_cores()} or not runs[0].scenario.learner.depends_on_cores:
        return None
    return (
        f"the training began on {' and '.join(map(str, sorted(began)))} core(s) and goes on with {usable_cores()}:"
        f" {runs[0].scenario.learner.algorithm} ends in another policy than on either alone"
    )
