"""The run folder: everything of one run, each file made on its own and written atomically.

`scenario.toml map.nc run.json state.safetensors train.nc policy.safetensors eval.nc report.html figures/`
"""

import json
import shutil
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.evaluate import Evaluation, HandoverRule, evaluate
from cellpilot.evaluate.flights import SINR_LEVELS_DB
from cellpilot.experiment import check_learner, fingerprint, make_learner, make_map, make_policies, make_task, shipped_policy
from cellpilot.policies import OptimalPolicy, PolicyParameters, load_parameters
from cellpilot.provenance import versions
from cellpilot.scenario import SHIPPED, Scenario, dump_scenario, find_scenario, load_scenario
from cellpilot.storage import TEMPORARY, read_json, save_netcdf, write_atomically, write_json
from cellpilot.task import Task
from cellpilot.world import World

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress, TrainingResult
    from cellpilot.maps import RadioMap

MARKERS = ("scenario.toml", "run.json")
FILES = {
    *MARKERS,
    "map.nc",
    "state.safetensors",
    "train.nc",
    "policy.safetensors",
    "eval.nc",
    "report.html",
    "figures",
    "ablation",
    "ablation.nc",
    "sensitivity",
    "sensitivity.nc",
    "tensorboard",
}
"""Everything a run folder can hold; only a folder with nothing else is ever replaced."""


NOT_A_RUN = "restore it, or train again"


@dataclass(frozen=True)
class Run:
    """A folder, its scenario and seed, and the map with what follows from it."""

    folder: Path
    scenario: Scenario
    seed: int
    radio_map: "RadioMap"
    world: World
    task: Task

    @property
    def policy_file(self) -> Path:
        """Where the trained policy lies."""
        return self.folder / "policy.safetensors"

    def parameters(self) -> PolicyParameters | None:
        """The trained policy, None before training has finished."""
        return load_parameters(self.policy_file) if self.policy_file.exists() else None

    def update_facts(self, **facts: Any) -> None:
        """Add entries to `run.json`."""
        path = self.folder / "run.json"
        write_json(path, read_json(path, NOT_A_RUN) | facts)


def create_run(folder: Path, scenario: Scenario, seed: int, command: str, force: bool = False, n_seeds: int = 1) -> Run:
    """Make the map and a new folder; `InputError` if it already holds a run (unless `force`) or other files.

    `n_seeds` is how many runs like this one will be trained at once.
    """
    folder = folder.resolve() if folder.is_symlink() else folder
    occupied = is_occupied(folder, force)
    radio_map = make_map(scenario.map)
    run = _assemble(folder, scenario, seed, radio_map)
    check_learner(scenario.learner, run.task, run.world.grid, n_seeds)
    OptimalPolicy.undiscounted(run.world, run.task).actions(run.world.free_cells[:1])  # refuses a task without an optimum
    if occupied:
        shutil.rmtree(folder)
    from cellpilot.maps import save_map

    folder.mkdir(parents=True, exist_ok=True)
    save_map(radio_map, folder / "map.nc")
    facts = {"seed": seed, "command": command, "versions": versions(), "started": time.strftime("%Y-%m-%dT%H:%M:%S%z")}
    write_json(folder / "run.json", facts)
    write_atomically(folder / "scenario.toml", dump_scenario(scenario))
    return run


def is_occupied(folder: Path, force: bool) -> bool:
    """Whether a run in the folder has to go first; `InputError` if there is one (unless `force`) or other files."""
    occupied = folder.exists() and (not folder.is_dir() or any(folder.iterdir()))
    replaceable = occupied and folder.is_dir() and all(_belongs_to_run(entry.name) for entry in folder.iterdir())
    if occupied and not (force and replaceable):
        hints = ["go on with --resume"] * _holds_run(folder) + ["replace it with --force"] * (replaceable and not force)
        raise InputError(f"{folder} is not empty; {', or '.join([*hints, 'choose an empty folder'])}")
    return occupied


def open_or_create_run(folder: Path, scenario: Scenario, command: str, seed: int = 0, n_seeds: int = 1) -> Run:
    """A new run, or the one in the folder if it is of the same scenario and seed; else `InputError`.

    `n_seeds` trainings will be held in memory at once.
    """
    if not _holds_run(folder):
        return create_run(folder, scenario, seed, command, n_seeds=n_seeds)
    run = open_run(folder)
    if (run.scenario, run.seed) != (scenario, seed):
        raise InputError(f"{folder} holds a run of other settings or another seed; choose another --out")
    return run


def open_run(name: str | Path) -> Run:
    """The run in a folder; `InputError` if the folder is missing or no run."""
    folder = Path(name)
    if not folder.is_dir():
        raise InputError(f"{folder}: no such run folder; expected one that cellpilot run or train has written")
    missing = [marker for marker in (*MARKERS, "map.nc") if not (folder / marker).is_file()]
    if missing:
        raise InputError(
            f"{folder}: not a run folder, {missing[0]} is missing; expected one that cellpilot run or train has written"
        )
    from cellpilot.maps import load_map

    seed = read_json(folder / "run.json", NOT_A_RUN).get("seed")
    if not isinstance(seed, int) or isinstance(seed, bool):
        raise InputError(f"{folder / 'run.json'}: seed is {seed!r}; expected a whole number")
    return _assemble(folder, load_scenario(folder / "scenario.toml"), seed, load_map(folder / "map.nc"))


def open_run_or_shipped(name: str, command: str) -> Run:
    """The run in a folder, or a new run folder `runs/NAME-shipped` around a policy that ships with the package."""
    if Path(name).is_dir() or Path(name).name != name or not (SHIPPED / f"{name}.safetensors").is_file():
        return open_run(name)
    source, folder = find_scenario(name), Path("runs") / f"{name}-shipped"
    policy = source.with_suffix(".safetensors").read_bytes()
    if (
        _holds_run(folder)
        and (folder / "policy.safetensors").is_file()
        and (folder / "policy.safetensors").read_bytes() == policy
    ):
        return open_run(folder)
    parameters = shipped_policy(source)
    assert parameters is not None
    run = create_run(folder, load_scenario(source), int(parameters.about.get("seed", 0)), command, force=True)
    write_atomically(run.policy_file, policy)
    return run


def train_run(run: Run, progress: "Callable[[TrainingProgress], None]" = lambda progress: None) -> "TrainingResult":
    """Train, going on from the folder's checkpoint if there is one; writes state, learning curve and policy."""
    return train_runs([run], progress)[0]


def train_runs(
    runs: Sequence[Run], progress: "Callable[[TrainingProgress], None]" = lambda progress: None
) -> "list[TrainingResult]":
    """`train_run` for runs that differ in their seed alone, all in one compiled program; `InputError` if they differ in more."""
    from cellpilot.envs.arena import make_arena
    from cellpilot.learn.trainer import train_many

    first = runs[0]
    mark = fingerprint(first.scenario, first.world)
    for run in runs[1:]:
        if fingerprint(run.scenario, run.world) != mark:
            raise InputError(f"{run.folder} has another map, task or learner than {first.folder}; train it apart")
    seeds = [run.seed for run in runs]
    if len(set(seeds)) < len(seeds):
        raise InputError(f"the runs have seeds {', '.join(map(str, seeds))}; expected a different one each")
    results = train_many(
        make_learner(first.scenario.learner),
        first.task,
        make_arena(first.world, first.scenario.task.start, first.scenario.task.goal),
        seeds,
        checkpoints=[run.folder / "state.safetensors" for run in runs],
        fingerprint=mark,
        progress=progress,
    )
    for run, result in zip(runs, results, strict=True):
        if result.finished:
            _save_training(run, result, mark)
    return results


def _save_training(run: Run, result: "TrainingResult", mark: str) -> None:
    from cellpilot.policies.learned import save_parameters

    about = {"scenario": run.scenario.name, "seed": run.seed, "fingerprint": mark, "task": asdict(run.task)}
    save_parameters(result.policy_parameters(run.world.grid.sides, about), run.policy_file)
    _write_history(run, result)
    run.update_facts(
        train_wall_s=round(result.train_wall_s, 3),
        compile_s=round(result.compile_s, 3),
        updates=result.settings.updates,
        env_steps=result.env_steps,
    )


def evaluate_run(
    run: Run, radio_map: "RadioMap | None" = None, progress: Callable[[float], None] = lambda share: None
) -> Evaluation:
    """Evaluate baseline, optima and the learned policy on the run's map (or another of the same grid)."""
    settings, task = run.scenario.evaluation, run.scenario.task
    world = run.world if radio_map is None else World.from_map(radio_map, task.noise_std_db)
    policies = make_policies(world, run.task, settings.boltzmann_temperature, run.parameters())
    return evaluate(
        world,
        run.task,
        policies,
        seed=settings.seed,
        n_sampled=settings.n_sampled,
        start=task.start,
        goal=task.goal,
        max_exhaustive_pairs=settings.max_exhaustive_pairs,
        rule=HandoverRule(settings.speed_mps, settings.hysteresis_db, settings.time_to_trigger_s),
        progress=progress,
    )


def finite(value: Any) -> Any:
    """The same value with infinities and NaN as None: JSON has no word for them."""
    if isinstance(value, dict):
        return {key: finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [finite(item) for item in value]
    return None if isinstance(value, float) and not np.isfinite(value) else value


def payload(run: Run, evaluation: Evaluation) -> dict[str, Any]:
    """What `evaluate --json` prints; a path ratio that is infinite (or undefined) is null."""
    return {
        "scenario": run.scenario.name,
        "exhaustive": evaluation.exhaustive,
        "n_pairs": evaluation.n_pairs,
        "unreachable_pairs": evaluation.unreachable_pairs,
        "speed_mps": run.scenario.evaluation.speed_mps,
        "policies": finite(evaluation.policies),
        "sampled": finite(evaluation.sampled),
    }


def save_evaluation(run: Run, evaluation: Evaluation) -> Path:
    """Write `eval.nc`: flights and SINR distribution by policy, metrics as JSON in an attribute."""
    import xarray as xr

    names = list(evaluation.flights)
    columns = {
        "reached": ("1", "goal reached"),
        "n_steps": ("1", "steps flown"),
        "shortest_steps": ("1", "steps of the shortest allowed path"),
        "drawn_return": ("1", "return"),
        "low_steps": ("1", "steps measured below the threshold"),
        "longest_outage_steps": ("1", "longest run of steps below the threshold"),
    }
    flights = {
        column: (
            ("policy", "flight"),
            np.stack([getattr(evaluation.flights[name], column) for name in names]),
            {"units": units, "long_name": text},
        )
        for column, (units, text) in columns.items()
    }
    histogram = np.stack([evaluation.sinr_histogram[name] for name in names])
    dataset = xr.Dataset(
        flights
        | {
            "sinr_histogram": (("policy", "sinr_bin"), histogram, {"units": "1", "long_name": "measurements between levels"}),
            "sinr_level_db": (("sinr_level",), SINR_LEVELS_DB, {"units": "dB", "long_name": "SINR level"}),
        },
        coords={"policy": names},
        attrs={
            "metrics": json.dumps(payload(run, evaluation)),
            "task": json.dumps(asdict(run.task)),
            "noise_std_db": run.world.noise_std_db,
        },
    )
    path = run.folder / "eval.nc"
    save_netcdf(dataset, path)
    return path


def _assemble(folder: Path, scenario: Scenario, seed: int, radio_map: "RadioMap") -> Run:
    world = World.from_map(radio_map, scenario.task.noise_std_db)
    world.start_goal_cells(scenario.task.start, scenario.task.goal)
    return Run(folder, scenario, seed, radio_map, world, make_task(scenario.task, world.grid))


def _belongs_to_run(name: str) -> bool:
    return name in FILES or name.startswith(TEMPORARY)


def _holds_run(folder: Path) -> bool:
    return all((folder / marker).is_file() for marker in MARKERS)


def _write_history(run: Run, result: "TrainingResult") -> None:
    import xarray as xr

    settings = result.settings
    texts = {
        "episode_return": "return of the exploring policy",
        "n_steps": "steps flown",
        "reached": "goal reached",
        "exploration": settings.explores_by,
    }
    dataset = xr.Dataset(
        {
            name: (("episode",), column, {"units": "1", "long_name": texts.get(name, name)})
            for name, column in result.history.items()
        },
        coords={"episode": np.arange(settings.rounds)},
        attrs={
            "algorithm": settings.algorithm,
            "exploration": "boltzmann" if settings.explores_by == "temperature" else "epsilon-greedy",
            "counts": settings.counts,
            "seed": run.seed,
        },
    )
    save_netcdf(dataset, run.folder / "train.nc")
