"""One run: making its folder, opening it, and the shipped policies, which need none."""

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellpilot.errors import InputError
from cellpilot.experiment import build_map, make_task, make_world, shipped_policy
from cellpilot.policies import OptimalPolicy, PolicyParameters, load_parameters
from cellpilot.provenance import usable_cores, versions
from cellpilot.runs.files import FACTS, MAP, MARKERS, NOT_A_RUN, SCENARIO, holds_run, is_occupied, read_facts, remove_run
from cellpilot.scenario import SHIPPED, Scenario, dump_scenario, find_scenario, load_scenario
from cellpilot.storage import hold, read_json, write_atomically, write_json
from cellpilot.task import Task
from cellpilot.world import World

if TYPE_CHECKING:
    from cellpilot.learn.learner import Place
    from cellpilot.maps import RadioMap


@dataclass(frozen=True)
class Run:
    """A folder, its scenario and seed, and the map with what follows from it."""

    folder: Path
    scenario: Scenario
    seed: int
    radio_map: "RadioMap"
    world: World
    task: Task
    shipped: PolicyParameters | None = None  # of a run that has no folder yet

    @property
    def place(self) -> "Place":
        """Where and for what its learner flies."""
        from cellpilot.learn.learner import Place

        return Place(self.world, self.task, self.scenario.task.start, self.scenario.task.goal)

    @property
    def policy_file(self) -> Path:
        """Where the trained policy lies."""
        return self.folder / "policy.safetensors"

    @property
    def saved(self) -> bool:
        """Whether there is a folder to write to; a shipped policy flies without one."""
        return self.shipped is None

    def parameters(self) -> PolicyParameters | None:
        """The trained policy, None before training has finished."""
        if self.shipped is not None:
            return self.shipped
        return load_parameters(self.policy_file) if self.policy_file.exists() else None

    def update_facts(self, **facts: Any) -> None:
        """Add entries to `run.json`."""
        path = self.folder / FACTS
        write_json(path, read_json(path, NOT_A_RUN) | facts)


def create_run(folder: Path, scenario: Scenario, seed: int, command: str, force: bool = False, n_seeds: int = 1) -> Run:
    """Make the map and a new folder; `InputError` if it already holds a run (unless `force`) or other files.

    `n_seeds` is how many runs like this one will be trained at once. A run that cannot be written leaves nothing behind.
    """
    occupied = is_occupied(folder, force)
    radio_map = build_map(scenario.map)
    run = _assemble(folder, scenario, seed, radio_map)
    scenario.learner.check_fits(run.task, run.world.grid, n_seeds)
    # Refuses a task without an optimum.
    OptimalPolicy.undiscounted(run.world, run.task).actions(run.world.airspace.free_cells[:1])
    if occupied:
        remove_run(folder)
    with _nothing_left(folder):
        _write_run(run, command)
    return run


@contextmanager
def _nothing_left(folder: Path) -> Iterator[None]:
    """Take away the first files of a run, and a folder made for them, if not all of them could be written."""
    new = not folder.exists()
    try:
        yield
    except BaseException:
        for name in (SCENARIO, MAP, FACTS):
            (folder / name).unlink(missing_ok=True)
        if new and folder.is_dir() and not any(folder.iterdir()):
            folder.rmdir()
        raise


def _write_run(run: Run, command: str) -> None:
    """The files that make a run. Only with the last of them, the scenario, it is one: see `is_occupied`."""
    from cellpilot.maps import save_map

    started = time.strftime("%Y-%m-%dT%H:%M:%S%z")
    facts = {"seed": run.seed, "command": command, "versions": versions(), "cores": usable_cores(), "started": started}
    write_json(run.folder / FACTS, facts)
    save_map(run.radio_map, run.folder / MAP)
    write_atomically(run.folder / SCENARIO, dump_scenario(run.scenario))


def open_or_create_run(folder: Path, scenario: Scenario, command: str, seed: int = 0, n_seeds: int = 1) -> Run:
    """A new run, or the one in the folder if it is of the same scenario and seed; else `InputError`.

    `n_seeds` trainings will be held in memory at once.
    """
    if not holds_run(folder):
        return create_run(folder, scenario, seed, command, n_seeds=n_seeds)
    run = open_run(folder)
    if (run.scenario, run.seed) != (scenario, seed):
        raise InputError(f"{folder} holds a run of other settings or another seed; choose another `out`")
    return run


def open_run(name: str | Path) -> Run:
    """The run in a folder; `InputError` if the folder is missing or no run."""
    folder = Path(name)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such run folder; expected one that cellpilot run or train has written")
    missing = [marker for marker in (*MARKERS, MAP) if not (folder / marker).is_file()]
    if missing:
        raise InputError(
            f"{folder}: not a run folder, {missing[0]} is missing; expected one that cellpilot run or train has written"
        )
    from cellpilot.maps import load_map

    seed = read_facts(folder).seed
    return _assemble(folder, load_scenario(folder / SCENARIO), seed, load_map(folder / MAP))


def open_run_or_shipped(name: str) -> Run:
    """The run in a folder, or one around a policy that ships with the package, which has no folder until `settle`."""
    if Path(name).is_dir() or Path(name).name != name or not (SHIPPED / f"{name}.safetensors").is_file():
        return open_run(name)
    source = find_scenario(name)
    parameters, scenario = shipped_policy(source), load_scenario(source)
    assert parameters is not None
    seed = int(parameters.about.get("seed", 0))
    return _assemble(Path("runs") / f"{name}-shipped", scenario, seed, build_map(scenario.map), parameters)


@contextmanager
def settle(run: Run, command: str) -> Iterator[Run]:
    """Hold the run's folder; that of a shipped policy is made, in the place of one that is there."""
    with hold(run.folder):
        if run.saved:
            yield run
            return
        if is_occupied(run.folder, force=True):
            remove_run(run.folder)
        with _nothing_left(run.folder):
            _write_run(run, command)
            write_atomically(run.policy_file, find_scenario(run.scenario.name).with_suffix(".safetensors").read_bytes())
        yield Run(run.folder, run.scenario, run.seed, run.radio_map, run.world, run.task)


def _assemble(folder: Path, scenario: Scenario, seed: int, radio_map: "RadioMap", shipped: PolicyParameters | None = None) -> Run:
    world = make_world(radio_map, scenario.task.noise_std_db, scenario.airspace)
    world.airspace.start_goal_cells(scenario.task.start, scenario.task.goal)
    return Run(folder, scenario, seed, radio_map, world, make_task(scenario.task, world.grid), shipped)
