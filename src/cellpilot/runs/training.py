"""Training in run folders: state while it goes on, policy and learning curve at its end."""

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.experiment import fingerprint
from cellpilot.runs.folder import Run
from cellpilot.runs.origin import map_digest
from cellpilot.storage import save_netcdf

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress, TrainingResult

EXPLORATIONS = {"temperature": "boltzmann", "epsilon": "epsilon-greedy"}
"""Kind of exploration by the quantity that it has."""


def train_run(run: Run, progress: "Callable[[TrainingProgress], None]" = lambda progress: None) -> "TrainingResult":
    """Train, going on from the folder's checkpoint if there is one; writes state, learning curve and policy."""
    return train_runs([run], progress)[0]


def train_runs(
    runs: Sequence[Run],
    progress: "Callable[[TrainingProgress], None]" = lambda progress: None,
    noticed: Callable[[], None] = lambda: None,
) -> "list[TrainingResult]":
    """`train_run` for runs that differ in their seed alone, all in one compiled program; `InputError` if they differ in more."""
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
        first.scenario.learner,
        first.place,
        seeds,
        checkpoints=[run.folder / "state.safetensors" for run in runs],
        fingerprint=mark,
        progress=progress,
        noticed=noticed,
    )
    for run, result in zip(runs, results, strict=True):
        if result.finished:
            _save_training(run, result, mark)
    return results


def _save_training(run: Run, result: "TrainingResult", mark: str) -> None:
    from cellpilot.policies.learned import save_parameters

    about = {"scenario": run.scenario.name, "seed": run.seed, "map": map_digest(run.radio_map)}
    about |= {"fingerprint": mark, "task": run.task.as_dict()}
    parameters = result.policy_parameters(about).trained_in(run.world.airspace)
    save_parameters(parameters, run.policy_file)
    _write_history(run, result)
    run.update_facts(
        train_wall_s=round(result.train_wall_s, 3),
        compile_s=round(result.compile_s, 3),
        updates=result.settings.updates,
        env_steps=result.env_steps,
    )


def _write_history(run: Run, result: "TrainingResult") -> None:
    import xarray as xr

    settings = result.settings
    texts = {
        "episode_return": "return of the exploring policy",
        "n_steps": "steps flown",
        "reached": "goal reached",
        "flights": "flights that ended",
        "exploration": settings.explores_by,
    }
    dataset = xr.Dataset(
        {
            name: (("episode",), column, {"units": "1", "long_name": texts.get(name, name)})
            for name, column in result.history.items()
        },
        coords={"episode": np.arange(settings.n_rounds)},
        attrs={
            "algorithm": settings.algorithm,
            "exploration": EXPLORATIONS.get(settings.explores_by, settings.explores_by),
            "counts": settings.counts,
            "seed": run.seed,
        },
    )
    save_netcdf(dataset, run.folder / "train.nc")
