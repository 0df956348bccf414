"""Studies over many trainings or many rewards: the ablation of section 5.4 and the sensitivity of section 4.2.2."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS
from cellpilot.experiment import fingerprint
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.runs import Run
from cellpilot.scenario import Scenario
from cellpilot.storage import load_array, save_array, save_netcdf
from cellpilot.task import Task

if TYPE_CHECKING:
    import xarray as xr

VARIANTS = {"DQN": (False, False), "DDQN": (True, False), "DQN+HER": (False, True), "DDQN+HER": (True, True)}
"""Figure 5.19: name -> (double, hindsight)."""

SWITCHED_LEARNER = "ddqn-her"
"""The thesis's algorithm, which alone has these two switches."""

EARLY_EPISODES = 3_000
"""The first part of training, over which the area under the learning curve is compared."""

RATIOS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
GOAL_REWARDS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SENSITIVITY_METRICS = ("low_sinr_share", "path_ratio_mean", "path_ratio_p90", "reached_share")


def check_ablation(scenario: Scenario) -> None:
    """`InputError` if the scenario's learner has no double learning and hindsight to switch off."""
    if not isinstance(scenario.learner, DDQNHER):
        raise InputError(
            f"the ablation switches double learning and hindsight of {SWITCHED_LEARNER}, but {scenario.name} trains "
            f"{scenario.learner.algorithm}: add --learner.algorithm {SWITCHED_LEARNER}"
        )


def ablation(run: Run, n_seeds: int, progress: Callable[[float], None] = lambda share: None) -> "xr.Dataset | None":
    """Learning curves `episode_return (variant, seed, episode)` of the four variants, seeds 0..n-1, into `ablation.nc`.

    All seeds of a variant are trained at once. Finished ones are kept in the folder `ablation/`, unfinished ones as
    checkpoints, so an interrupted study goes on where it stopped; None if it was interrupted.
    """
    import xarray as xr

    curves: list[np.ndarray] = []
    for i, name in enumerate(VARIANTS):
        of_variant = _variant_curves(run, name, n_seeds, partial(_within, progress, i, len(VARIANTS)))
        if of_variant is None:
            return None
        curves.append(of_variant)
    values = np.stack(curves).astype(np.float32)
    dataset = xr.Dataset(
        {
            "episode_return": (
                ("variant", "seed", "episode"),
                values,
                {"units": "1", "long_name": "return of the exploring policy"},
            )
        },
        coords={"variant": list(VARIANTS), "seed": np.arange(n_seeds)},
        attrs={"scenario": run.scenario.name},
    )
    save_netcdf(dataset, run.folder / "ablation.nc")
    return dataset


def _variant_curves(run: Run, name: str, n_seeds: int, progress: Callable[[float], None]) -> np.ndarray | None:
    """Learning curves `[seeds, episodes]` of one variant, read or trained; None if training was interrupted."""
    from cellpilot.learn.compile import forget_programs
    from cellpilot.learn.trainer import train_many

    double, hindsight = VARIANTS[name]
    published = run.scenario.learner.model_dump(exclude={"algorithm"})
    learner = DDQNHERVariants(**published | {"double": double, "hindsight": hindsight})
    mark = fingerprint(run.scenario.changed(learner=learner), run.world)
    folder = run.folder / "ablation"
    file = lambda seed: folder / f"{name}-{seed}-{mark}.npy"
    checkpoint = lambda seed: folder / f"{name}-{seed}.safetensors"
    if missing := [seed for seed in range(n_seeds) if not file(seed).is_file()]:
        results = train_many(
            learner,
            run.place,
            missing,
            checkpoints=[checkpoint(seed) for seed in missing],
            fingerprint=mark,
            progress=lambda p: progress(p.done / p.rounds),
        )
        if not all(result.finished for result in results):
            return None
        for result in results:
            curve = result.history["episode_return"]
            save_array(curve, file(result.seed))
            checkpoint(result.seed).unlink()
        forget_programs()
    progress(1.0)
    return np.stack([load_array(file(seed)) for seed in range(n_seeds)])


def early_return(dataset: "xr.Dataset") -> dict[str, tuple[float, float]]:
    """Mean return per episode over the first 3,000 episodes by variant: mean and standard deviation over seeds.

    This is the area under the learning curve divided by its width.
    """
    early = dataset["episode_return"].isel(episode=slice(EARLY_EPISODES)).mean("episode")
    spread = early.std("seed", ddof=1)  # NaN for one seed
    return {
        str(name): (float(early.sel(variant=name).mean()), float(spread.sel(variant=name))) for name in early["variant"].values
    }


def sensitivity(run: Run, learned: bool, progress: Callable[[float], None] = lambda share: None) -> "xr.Dataset | None":
    """Share below the threshold and detour as the reward parameters vary one at a time, into `sensitivity.nc`.

    Exact figures of the baseline and of the optimum for each reward; with `learned` the scenario's learner is trained
    at each point too. None if it was interrupted.
    """
    import xarray as xr

    if not run.task.rho_step:
        raise InputError("rho_step is 0, so there is no ratio rho_sinr / rho_step to vary: give the step a cost")
    points = list(_points(run.task))
    rows: list[dict[str, object]] = []
    for i, (knob, value, task) in enumerate(points):
        policies: list[Policy] = [GreedyPolicy(run.world), OptimalPolicy(run.world, task)]
        if learned:
            within = partial(_within, progress, i, len(points))
            trained = _train_for(run, task, within)
            if trained is None:
                return None
            policies.append(trained)
        for policy in policies:
            summary = exhaustive_summary(None, run.world, task, policy, run.scenario.task.start, run.scenario.task.goal)
            figures = {name: METRICS[name].compute(summary) for name in SENSITIVITY_METRICS}
            rows.append({"knob": knob, "value": value, "policy": policy.name} | figures)
        progress((i + 1) / len(points))
    about = {name: {"units": METRICS[name].unit, "long_name": METRICS[name].label} for name in SENSITIVITY_METRICS}
    columns = {
        name: ("point", np.array([row[name] if row[name] is not None else np.nan for row in rows]), about.get(name, {}))
        for name in rows[0]
    }
    dataset = xr.Dataset(
        columns,
        attrs={
            "threshold_db": run.task.threshold_db,
            "default_ratio": run.task.rho_sinr / run.task.rho_step,
            "default_rho_goal": run.task.rho_goal,
        },
    )
    save_netcdf(dataset, run.folder / "sensitivity.nc")
    return dataset


def _within(progress: Callable[[float], None], i: int, n: int, share: float) -> None:
    progress((i + share) / n)


def _points(task: Task) -> Iterator[tuple[str, float, Task]]:
    for ratio in RATIOS:
        yield "rho_sinr/rho_step", ratio, replace(task, rho_sinr=ratio * task.rho_step)
    for reward in GOAL_REWARDS:
        yield "rho_goal", reward, replace(task, rho_goal=reward)


def _train_for(run: Run, task: Task, progress: Callable[[float], None]) -> LearnedPolicy | None:
    """The learner trained on the run's map for other rewards; kept in the folder `sensitivity/`, one file per task."""
    from cellpilot.learn.compile import forget_programs
    from cellpilot.learn.trainer import train

    settings = run.scenario.learner
    mark = f"{fingerprint(run.scenario, run.world)}-{task.rho_sinr:g}-{task.rho_goal:g}-{run.seed}"
    file = run.folder / "sensitivity" / f"{mark}.safetensors"
    if not file.is_file():
        checkpoint = run.folder / "sensitivity" / f"state-{mark}.safetensors"
        share = lambda p: progress(p.done / p.rounds)
        result = train(settings, replace(run.place, task=task), run.seed, checkpoint=checkpoint, fingerprint=mark, progress=share)
        if not result.finished:
            return None
        parameters = result.policy_parameters({"task": task.as_dict()})
        save_parameters(parameters.trained_in(run.world.airspace), file)
        checkpoint.unlink()
        forget_programs()
    # What one would fly: arg max of near-exact values, but that of the published learner's circles.
    temperature = run.scenario.evaluation.boltzmann_temperature if isinstance(settings, DDQNHER) else None
    return LearnedPolicy(load_parameters(file), run.world.grid, temperature)
