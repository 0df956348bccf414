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
from cellpilot.storage import load_netcdf, read_json
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
    about: dict[str, Any]  # run.json

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
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{folder / 'eval.nc'}: attribute missing or unreadable ({error}); evaluate the run again") from error
    radio_map = load_map(folder / "map.nc")
    policy = folder / "policy.safetensors"
    return Content(
        radio_map=radio_map,
        world=World.from_map(radio_map, noise_std_db),
        task=task,
        metrics=metrics,
        flights=flights,
        parameters=load_parameters(policy) if policy.exists() else None,
        training=_dataset(folder / "train.nc"),
        ablation=_dataset(folder / "ablation.nc"),
        sensitivity=_dataset(folder / "sensitivity.nc"),
        about=read_json(folder / "run.json", "restore or delete it") if (folder / "run.json").exists() else {},
    )


def _dataset(path: Path) -> xr.Dataset | None:
    return load_netcdf(path, "what cellpilot has written: make it again") if path.exists() else None
