"""Synthetic run folders, made by the functions that make real ones, for the tests of the report."""

import json
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import xarray as xr

from cellpilot.evaluate import Evaluation, evaluate_policies
from cellpilot.evaluate.flights import SINR_LEVELS_DB
from cellpilot.maps import RadioMap, make_map, save_map
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_RAY
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy, PolicyParameters
from cellpilot.policies.learned import save_parameters
from cellpilot.radio import hexagonal_deployment
from cellpilot.task import Task, default_max_steps
from cellpilot.world import World

FLIGHT_VARIABLES = ("reached", "n_steps", "shortest_steps", "drawn_return", "low_steps", "longest_outage_steps")


def small_map(n_heights: int = 1, sectors: bool = True, special: bool = False) -> RadioMap:
    """8 x 6 cells with a dip of low SINR in the middle; with `special` some cells are blocked and one is unknown."""
    x_m, y_m, z_m = np.arange(8) * 20.0 - 70, np.arange(6) * 20.0 - 50, 20.0 + 20 * np.arange(n_heights)
    z, y, x = np.meshgrid(z_m, y_m, x_m, indexing="ij")
    sinr_db = 12 - 14 * np.exp(-((x - 10) ** 2 + (y + 10) ** 2) / 1500) - (z - 20) / 10
    blocked_reason = np.zeros(sinr_db.shape, dtype=np.uint8)
    if special:
        sinr_db[:, 5, 7] = np.nan
        blocked_reason[:, 5, 7] = 2
        blocked_reason[:, 0:3, 2] = 1
    where = hexagonal_deployment()
    sites = {
        "sector_name": np.array([f"sector {i}" for i in range(where.n_sectors)]),
        "sector_x_m": where.x_m,
        "sector_y_m": where.y_m,
        "sector_height_m": where.height_m,
        "sector_boresight_deg": where.boresight_deg,
    }
    return make_map(
        sinr_db,
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        blocked_reason=blocked_reason,
        reasons=(INSIDE_BUILDING, NO_RAY),
        source="synthetic <test>",
        sectors=sites if sectors else None,
    )


def random_parameters(world: World, seed: int = 0) -> PolicyParameters:
    """A network of the thesis's shape with random weights."""
    rng = np.random.default_rng(seed)
    sizes = (2 * world.grid.n_dimensions, 16, world.airspace.n_actions)
    tensors = {}
    for i, (n_in, n_out) in enumerate(pairwise(sizes)):
        tensors[f"network.layers.{i}.weight"] = rng.normal(size=(n_out, n_in)).astype(np.float32)
        tensors[f"network.layers.{i}.bias"] = rng.normal(size=n_out).astype(np.float32)
    return PolicyParameters(tensors, "concatenated", world.grid.sides)


def write_run(
    folder: Path,
    radio_map: RadioMap,
    *,
    scenario: str = "test-scenario",
    noise_std_db: float = 0.0,
    parameters: PolicyParameters | None = None,
    episodes: int = 0,
    studies: bool = False,
    n_sampled: int = 300,
    max_exhaustive_pairs: int = 5_000_000,
) -> Evaluation:
    """Write a run folder and return the evaluation in it; `episodes` of made-up training, made-up `studies`."""
    folder.mkdir(parents=True, exist_ok=True)
    world = World.from_map(radio_map, noise_std_db)
    task = Task(max_steps=default_max_steps(world.grid))
    policies: list[Policy] = [GreedyPolicy(world), OptimalPolicy(world, task), OptimalPolicy.undiscounted(world, task)]
    if parameters is not None:
        policies += [LearnedPolicy(parameters, world.grid), LearnedPolicy(parameters, world.grid, 0.1)]
        save_parameters(parameters, folder / "policy.safetensors")
    result = evaluate_policies(world, task, policies, seed=3, n_sampled=n_sampled, max_exhaustive_pairs=max_exhaustive_pairs)
    save_map(radio_map, folder / "map.nc")
    _save(evaluation_dataset(result, task, scenario, noise_std_db), folder / "eval.nc")
    if episodes:
        _save(made_up_training(episodes), folder / "train.nc")
        about = {"seed": 3, "train_wall_s": 12.5, "compile_s": 3.0, "updates": 900, "env_steps": 8000}
        about |= {"versions": {"numpy": np.__version__}, "command": "cellpilot run <scenario>"}
        (folder / "run.json").write_text(json.dumps(about))
    if studies:
        _save(made_up_ablation(), folder / "ablation.nc")
        _save(made_up_sensitivity(), folder / "sensitivity.nc")
    return result


def evaluation_dataset(result: Evaluation, task: Task, scenario: str, noise_std_db: float) -> xr.Dataset:
    """`eval.nc` of an evaluation."""
    names = list(result.flights)
    data: dict[str, Any] = {
        name: (("policy", "flight"), np.stack([getattr(result.flights[policy], name) for policy in names]))
        for name in FLIGHT_VARIABLES
    }
    data["sinr_histogram"] = (("policy", "sinr_bin"), np.stack([result.sinr_histogram[policy] for policy in names]))
    metrics = {name: getattr(result, name) for name in ("exhaustive", "n_pairs", "unreachable_pairs", "policies", "sampled")}
    return xr.Dataset(
        data,
        {"policy": names, "sinr_level_db": ("sinr_level", SINR_LEVELS_DB)},
        {
            "metrics": json.dumps({"scenario": scenario, **metrics}),
            "task": json.dumps(task.as_dict()),
            "noise_std_db": noise_std_db,
        },
    )


def made_up_training(episodes: int, seed: int = 0, counts: str = "episodes") -> xr.Dataset:
    """Curves with the look of a training."""
    rng = np.random.default_rng(seed)
    progress = np.arange(episodes) / episodes
    learned = 1 - np.exp(-6 * progress)
    reached = rng.random(episodes) < 0.3 + 0.69 * learned
    returns = np.where(reached, 7 * learned - 3 + rng.normal(0, 2, episodes), -40 + rng.normal(0, 10, episodes))
    return xr.Dataset(
        {
            "episode_return": ("episode", returns.astype(np.float32)),
            "n_steps": ("episode", np.where(reached, 20, 400).astype(np.int32)),
            "reached": ("episode", reached),
            "exploration": ("episode", np.maximum(2 - 3.8 * progress, 0.1).astype(np.float32)),
        },
        attrs={"exploration": "boltzmann", "counts": counts, "seed": 3},
    )


def made_up_ablation(episodes: int = 400) -> xr.Dataset:
    """Four variants, five seeds."""
    rng = np.random.default_rng(1)
    variants = ["DQN", "DDQN", "DQN+HER", "DDQN+HER"]
    ends = np.array([-60.0, -58.0, 4.0, 6.0])[:, None, None]
    shape = 1 - np.exp(-np.arange(episodes) / 60)
    returns = ends * shape - 80 * (1 - shape) + rng.normal(0, 4, (4, 5, 1)) + rng.normal(0, 8, (4, 5, episodes))
    return xr.Dataset({"episode_return": (("variant", "seed", "episode"), returns)}, {"variant": variants, "seed": np.arange(5)})


def made_up_sensitivity() -> xr.Dataset:
    """Two knobs, two policies."""
    rows = []
    for policy, detour in (("optimal", 1.0), ("learned/argmax", 1.4)):
        for ratio in (1.0, 3.0, 10.0, 30.0, 100.0):
            rows.append(
                ("rho_sinr/rho_step", ratio, policy, 0.13 * ratio**-0.3, 1 + 0.05 * detour, 1 + 0.1 * detour * ratio**0.2, 1.0)
            )
        for goal in (1.0, 5.0, 10.0, 20.0):
            rows.append(("rho_goal", goal, policy, 0.05, 1 + 0.05 * detour, 1 + 0.2 * detour, min(1.0, 0.9 + goal / 100)))
    names = ("knob", "value", "policy", "low_sinr_share", "path_ratio_mean", "path_ratio_p90", "reached_share")
    columns = {name: ("point", np.array([row[i] for row in rows])) for i, name in enumerate(names)}
    return xr.Dataset(columns, attrs={"threshold_db": 3.0, "default_ratio": 10.0, "default_rho_goal": 10.0})


def _save(dataset: xr.Dataset, path: Path) -> None:
    dataset.to_netcdf(path, engine="h5netcdf")
