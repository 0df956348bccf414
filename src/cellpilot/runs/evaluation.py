"""Evaluating a run, and `eval.nc`, which knows what it was made from."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from cellpilot.evaluate import Evaluation, evaluate_policies
from cellpilot.evaluate.flights import SINR_LEVELS_DB
from cellpilot.experiment import make_policies, make_world
from cellpilot.policies import PolicyParameters
from cellpilot.provenance import digest, versions
from cellpilot.runs.folder import Run
from cellpilot.runs.origin import map_digest, policy_digest
from cellpilot.storage import load_netcdf, save_netcdf

if TYPE_CHECKING:
    import xarray as xr

    from cellpilot.maps import RadioMap


def evaluate_run(
    run: Run, radio_map: "RadioMap | None" = None, progress: Callable[[float], None] = lambda share: None
) -> Evaluation:
    """Evaluate baseline, optima and the learned policy on the run's map (or another of the same grid)."""
    settings, task = run.scenario.evaluation, run.scenario.task
    world = run.world if radio_map is None else make_world(radio_map, task.noise_std_db, run.scenario.airspace)
    parameters = run.parameters()
    policies = make_policies(world, run.task, settings.boltzmann_temperature, parameters)
    evaluation = evaluate_policies(
        world,
        run.task,
        policies,
        seed=settings.seed,
        n_sampled=settings.n_sampled,
        start=task.start,
        goal=task.goal,
        max_exhaustive_pairs=settings.max_exhaustive_pairs,
        rule=settings,
        progress=progress,
    )
    return replace(evaluation, made_from=_made_from(run, parameters))


def made_from(run: Run) -> dict[str, str]:
    """What an evaluation of the run depends on, by name: digests of policy, map, task and settings, and the version."""
    return _made_from(run, run.parameters())


def _made_from(run: Run, parameters: PolicyParameters | None) -> dict[str, str]:
    of_text = lambda text: digest([np.frombuffer(text.encode(), np.uint8)])
    return {
        "policy": policy_digest(parameters),
        "map": map_digest(run.radio_map),
        "task": of_text(
            run.scenario.task.model_dump_json() + run.scenario.airspace.model_dump_json() + json.dumps(run.task.as_dict())
        ),
        "evaluation settings": of_text(run.scenario.evaluation.model_dump_json()),
        "version of cellpilot": versions().get("cellpilot", "unknown"),
    }


def stale_parts(run: Run) -> list[str] | None:
    """In what the run has changed since its `eval.nc` was made: nothing, or some of `made_from`; None without an `eval.nc`."""
    if not (run.folder / "eval.nc").is_file():
        return None
    try:
        then = json.loads(str(load_evaluation(run.folder).attrs.get("made_from", "{}")))
    except (ValueError, RecursionError):
        then = {}
    now = made_from(run)
    return [name for name in now if not isinstance(then, dict) or then.get(name) != now[name]]


def load_evaluation(folder: Path) -> "xr.Dataset":
    """`eval.nc` of a run folder; `InputError` if it is missing or damaged."""
    return load_netcdf(folder / "eval.nc", "the evaluation of a run: evaluate it again (cellpilot evaluate)")


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
            "task": json.dumps(run.task.as_dict()),
            "airspace": run.scenario.airspace.model_dump_json(),
            "noise_std_db": run.world.signal.noise_std_db,
            "made_from": json.dumps(evaluation.made_from),
        },
    )
    path = run.folder / "eval.nc"
    save_netcdf(dataset, path)
    return path
