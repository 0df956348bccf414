"""The sensitivity of section 4.2.2: what the rewards do."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS
from cellpilot.experiment import fingerprint
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.runs import Run
from cellpilot.storage import save_netcdf
from cellpilot.task import Task

if TYPE_CHECKING:
    import xarray as xr
from cellpilot.studies.progress import within

RATIOS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
GOAL_REWARDS = (1.0, 2.0, 5.0, 10.0, 20.0, 50.0, 100.0)
SENSITIVITY_METRICS = ("low_sinr_share", "path_ratio_mean", "path_ratio_p90", "reached_share")


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
            share_of_all = partial(within, progress, i, len(points))
            trained = _train_for(run, task, share_of_all)
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


def _points(task: Task) -> Iterator[tuple[str, float, Task]]:
    for ratio in RATIOS:
        yield "rho_sinr/rho_step", ratio, replace(task, rho_sinr=ratio * task.rho_step)
    for reward in GOAL_REWARDS:
        yield "rho_goal", reward, replace(task, rho_goal=reward)


def _train_for(run: Run, task: Task, progress: Callable[[float], None]) -> LearnedPolicy | None:
    """The learner trained on the run's map for other rewards; kept in the folder `sensitivity/`, one file per task."""
    from cellpilot.learn.compile import forget_programs
    from cellpilot.learn.trainer import train_one

    settings = run.scenario.learner
    mark = f"{fingerprint(run.scenario, run.world)}-{task.rho_sinr:g}-{task.rho_goal:g}-{run.seed}"
    file = run.folder / "sensitivity" / f"{mark}.safetensors"
    if not file.is_file():
        checkpoint = run.folder / "sensitivity" / f"state-{mark}.safetensors"
        share = lambda p: progress(p.done / p.rounds)
        result = train_one(
            settings, replace(run.place, task=task), run.seed, checkpoint=checkpoint, fingerprint=mark, progress=share
        )
        if not result.finished:
            return None
        parameters = result.policy_parameters({"task": task.as_dict()})
        save_parameters(parameters.trained_in(run.world.airspace), file)
        checkpoint.unlink()
        forget_programs()
    # What one would fly: arg max of near-exact values, but that of the published learner's circles.
    temperature = run.scenario.evaluation.boltzmann_temperature if isinstance(settings, DDQNHER) else None
    return LearnedPolicy(load_parameters(file), run.world.grid, temperature)
