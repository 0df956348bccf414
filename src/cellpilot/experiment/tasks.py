"""The task that a scenario sets on a grid, and what a training result depends on."""

from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.grid import Grid
from cellpilot.provenance import digest
from cellpilot.scenario import AirspaceSettings, RewardSettings, Scenario
from cellpilot.signal import Unknown
from cellpilot.task import Task, default_max_steps
from cellpilot.world import World

if TYPE_CHECKING:
    from cellpilot.maps import RadioMap


def make_task(settings: RewardSettings, grid: Grid) -> Task:
    """The task on a grid; the cap on steps follows from its sides unless it is given."""
    rewards = {name: getattr(settings, name) for name in Task().as_dict() if name != "max_steps"}
    return Task(**rewards, max_steps=default_max_steps(grid) if settings.max_steps is None else settings.max_steps)


def make_world(radio_map: "RadioMap", noise_std_db: float, settings: AirspaceSettings) -> World:
    """The world of a map, with the moves and the rule for forbidden ones that the settings ask for."""
    return World.from_map(radio_map, noise_std_db, settings.rule, settings.moves)


def fingerprint(scenario: Scenario, world: World) -> str:
    """Names everything a training result depends on besides the seed: map, task and learner."""
    text = "".join(part.model_dump_json() for part in (scenario.task, scenario.airspace, scenario.learner))
    signal, sides = world.signal, np.array(world.grid.sides)
    arrays = [
        signal.mean_db,
        signal.std_db,
        *([] if signal.unknown is None else _arrays(signal.unknown)),
        world.airspace.blocked.astype(np.uint8),
        sides,
        np.frombuffer(text.encode(), np.uint8),
    ]
    return digest(arrays)


def _arrays(unknown: Unknown) -> list[np.ndarray]:
    """Everything that decides how the errors of a map are drawn."""
    parts = [getattr(unknown, field.name) for field in fields(unknown)]
    return [np.asarray(a) for part in parts for a in (part if isinstance(part, tuple) else (part,)) if a is not None]
