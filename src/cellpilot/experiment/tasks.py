"""The task that a scenario sets on a grid, and what a training result depends on."""

import numpy as np

from cellpilot.grid import Grid
from cellpilot.provenance import digest
from cellpilot.scenario import RewardSettings, Scenario
from cellpilot.task import Task, default_max_steps
from cellpilot.world import World


def make_task(settings: RewardSettings, grid: Grid) -> Task:
    """The task on a grid; the cap on steps follows from its sides unless it is given."""
    return Task(
        rho_goal=settings.rho_goal,
        rho_sinr=settings.rho_sinr,
        rho_step=settings.rho_step,
        rho_blocked=settings.rho_blocked,
        threshold_db=settings.threshold_db,
        discount=settings.discount,
        max_steps=default_max_steps(grid) if settings.max_steps is None else settings.max_steps,
    )


def fingerprint(scenario: Scenario, world: World) -> str:
    """Names everything a training result depends on besides the seed: map, task and learner."""
    text = scenario.task.model_dump_json() + scenario.learner.model_dump_json()
    arrays = [world.sinr_db, world.sinr_std_db, world.blocked, np.array(world.grid.sides), np.frombuffer(text.encode(), np.uint8)]
    return digest(arrays)
