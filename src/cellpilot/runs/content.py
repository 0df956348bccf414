"""`Content`: everything a report shows, read from a run folder."""

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps import RadioMap, load_map
from cellpilot.policies import LearnedPolicy, OptimalPolicy, PolicyParameters, load_parameters
from cellpilot.runs.checks import check_metrics, check_variables
from cellpilot.runs.files import RunFacts, read_facts
from cellpilot.runs.origin import map_digest, policy_digest
from cellpilot.scenario import AirspaceSettings
from cellpilot.storage import load_netcdf, parse_json
from cellpilot.task import Task
from cellpilot.world import World


@dataclass(frozen=True)
class Content:
    """One run: its map, its evaluation, and whatever of training and studies the folder holds."""

    radio_map: RadioMap
    world: World
    task: Task
    metrics: dict[str, Any]  # scenario, exhaustive, n_pairs, unreachable_pairs, policies, sampled
    flights: xr.Dataset  # (policy, flight) and the SINR histogram
    parameters: PolicyParameters | None
    training: xr.Dataset | None  # [episode]
    ablation: xr.Dataset | None  # [variant, seed, episode]
    sensitivity: xr.Dataset | None  # [point]
    facts: RunFacts | None  # run.json

    @property
    def scenario(self) -> str:
        """Name of the scenario."""
        return str(self.metrics.get("scenario", "unnamed run"))

    @property
    def is_3d(self) -> bool:
        """Whether the flights may change their height."""
        return self.world.grid.n_dimensions == 3

    @property
    def policy_names(self) -> list[str]:
        """Policies that were flown, in the order of the evaluation."""
        return [str(name) for name in self.flights["policy"].values]

    @cached_property
    def shown_policy(self) -> LearnedPolicy | OptimalPolicy:
        """The policy whose actions are drawn: arg max of the learned one, else the optimum."""
        if self.parameters is not None:
            return LearnedPolicy(self.parameters, self.world.grid)
        return OptimalPolicy(self.world, self.task)


def load_content(folder: Path) -> Content:
    """Read a run folder; `InputError` where `map.nc` or `eval.nc` is missing or something in it cannot be read."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such folder; expected a run (cellpilot run or cellpilot evaluate makes one)")
    flights = _dataset(folder / "eval.nc")
    if flights is None:
        raise InputError(f"{folder}: has no eval.nc; evaluate the run first (cellpilot evaluate)")
    try:
        metrics, task = json.loads(flights.attrs["metrics"]), Task(**json.loads(flights.attrs["task"]))
        noise_std_db = float(flights.attrs["noise_std_db"])
        airspace = AirspaceSettings(**json.loads(flights.attrs.get("airspace", "{}")))
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise InputError(f"{folder / 'eval.nc'}: attribute missing or unreadable ({error}); evaluate the run again") from error
    check_variables(flights, "eval", str(folder / "eval.nc"))
    check_metrics(metrics, str(folder / "eval.nc"))
    radio_map = load_map(folder / "map.nc")
    policy = folder / "policy.safetensors"
    parameters = load_parameters(policy) if policy.exists() else None
    _check_origin(folder, flights, radio_map, parameters)
    return Content(
        radio_map=radio_map,
        world=World.from_map(radio_map, noise_std_db, airspace.rule, airspace.moves),
        task=task,
        metrics=metrics,
        flights=flights,
        parameters=parameters,
        training=_dataset(folder / "train.nc"),
        ablation=_dataset(folder / "ablation.nc"),
        sensitivity=_dataset(folder / "sensitivity.nc"),
        facts=read_facts(folder) if (folder / "run.json").exists() else None,
    )


def _check_origin(folder: Path, flights: xr.Dataset, radio_map: RadioMap, parameters: PolicyParameters | None) -> None:
    """`InputError` if the evaluation says that it is of another map or policy than those beside it."""
    if "made_from" not in flights.attrs:
        return
    stated = parse_json(str(flights.attrs["made_from"]), f"{folder / 'eval.nc'}, attribute made_from", "evaluate the run again")
    here = {"policy": policy_digest(parameters), "map": map_digest(radio_map)}
    other = [name for name, mark in here.items() if stated.get(name) != mark]
    if other:
        raise InputError(f"{folder / 'eval.nc'}: was made with another {' and another '.join(other)}; evaluate the run again")


def _dataset(path: Path) -> xr.Dataset | None:
    if not path.exists():
        return None
    found = load_netcdf(path, "what cellpilot has written: make it again")
    return found if path.stem == "eval" else check_variables(found, path.stem, str(path))
