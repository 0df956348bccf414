"""Gymnasium environments by name; importing this module registers them (extra `gym`).

    import gymnasium
    import cellpilot.gym

    env = gymnasium.make("cellpilot/Thesis2D-v0")

or in one, `gymnasium.make("cellpilot.gym:cellpilot/Thesis2D-v0")`. `gymnasium.make_vec` gives many flights at once, stepped
by NumPy. Gymnasium has no way to find environments of a package that was not imported (since 1.0).
"""

from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from pydantic import ValidationError

try:
    import gymnasium
except ImportError as error:
    raise ImportError("the environments need Gymnasium: pip install 'cellpilot[gym]'") from error

from cellpilot.envs.goal_env import GoalEnv
from cellpilot.envs.goal_rules import place_of
from cellpilot.envs.vector_env import GoalVectorEnv
from cellpilot.errors import InputError
from cellpilot.experiment import build_map, make_task, make_world
from cellpilot.maps import RadioMap, load_map
from cellpilot.scenario import AirspaceSettings, TaskSettings, describe, find_scenario, load_scenario

SCENARIOS = {
    "cellpilot/Thesis2D-v0": "thesis-2d",
    "cellpilot/Thesis2DNoise-v0": "thesis-2d-noise",
    "cellpilot/Thesis3D-v0": "thesis-3d",
}
"""Environments of shipped scenarios."""
RADIO_MAP = "cellpilot/RadioMap-v0"
"""The environment over a map of one's own."""


def scenario_env(scenario: str, render_mode: str | None = None, **settings: Any) -> GoalEnv:
    """One flight of a scenario; `settings` are those of its task (`threshold_db`, `rho_sinr`, `noise_std_db`, `start`, ...)."""
    return GoalEnv(**_scenario_facts(scenario, settings), render_mode=render_mode)


def scenario_vector_env(
    scenario: str,
    num_envs: int = 1,
    autoreset_mode: str = "NextStep",
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> GoalVectorEnv:
    """Many flights of a scenario; `settings` as for one. `max_episode_steps` lowers the task's cap on steps."""
    facts = _capped(_scenario_facts(scenario, settings), max_episode_steps)
    return GoalVectorEnv(**facts, num_envs=num_envs, autoreset_mode=autoreset_mode, render_mode=render_mode)


def map_env(map_file: str | Path = "", render_mode: str | None = None, **settings: Any) -> GoalEnv:
    """One flight over the map in a file; `settings` are those of the task, whose defaults are the thesis's."""
    return GoalEnv(**_map_facts(map_file, settings), render_mode=render_mode)


def map_vector_env(
    map_file: str | Path = "",
    num_envs: int = 1,
    autoreset_mode: str = "NextStep",
    render_mode: str | None = None,
    max_episode_steps: int | None = None,
    **settings: Any,
) -> GoalVectorEnv:
    """Many flights over the map in a file; `settings` as for one. `max_episode_steps` lowers the task's cap on steps."""
    facts = _capped(_map_facts(map_file, settings), max_episode_steps)
    return GoalVectorEnv(**facts, num_envs=num_envs, autoreset_mode=autoreset_mode, render_mode=render_mode)


def _capped(facts: dict[str, Any], max_episode_steps: int | None) -> dict[str, Any]:
    """The smaller of two caps on steps: Gymnasium's own wrapper for it knows one flight only."""
    if max_episode_steps is None:
        return facts
    return facts | {"task": replace(facts["task"], max_steps=min(max_episode_steps, facts["task"].max_steps))}


def _scenario_facts(name: str, settings: dict[str, Any]) -> dict[str, Any]:
    scenario = load_scenario(find_scenario(name))
    return _facts(_scenario_map(name), scenario.task, scenario.airspace, settings, name)


def _map_facts(map_file: str | Path, settings: dict[str, Any]) -> dict[str, Any]:
    if not map_file:
        raise InputError(f"{RADIO_MAP} needs a map: gymnasium.make('{RADIO_MAP}', map_file='map.nc')")
    return _facts(load_map(map_file), TaskSettings(), AirspaceSettings(), settings, RADIO_MAP)


def _facts(
    radio_map: RadioMap, task: TaskSettings, airspace: AirspaceSettings, settings: dict[str, Any], where: str
) -> dict[str, Any]:
    """Arguments that both kinds of environment share."""
    settings = settings | {name: place_of(settings[name]) for name in ("start", "goal") if name in settings}
    of_airspace = {name: settings.pop(name) for name in AirspaceSettings.model_fields if name in settings}
    try:
        airspace = AirspaceSettings.model_validate(airspace.model_dump() | of_airspace)
        task = TaskSettings.model_validate(task.model_dump() | settings)
    except ValidationError as error:
        raise InputError(describe(error, where)) from error
    world = make_world(radio_map, task.noise_std_db, airspace)
    return {"world": world, "task": make_task(task, world.grid), "start": task.start, "goal": task.goal}


@lru_cache(maxsize=8)
def _scenario_map(name: str) -> RadioMap:
    # Simulated once: a vector environment in Gymnasium's other modes makes its flights one by one.
    return build_map(load_scenario(find_scenario(name)).map)


def _register() -> None:
    here = __name__
    for name, scenario in SCENARIOS.items():
        gymnasium.register(
            name,
            entry_point=f"{here}:scenario_env",
            vector_entry_point=f"{here}:scenario_vector_env",
            kwargs={"scenario": scenario},
        )
    gymnasium.register(RADIO_MAP, entry_point=f"{here}:map_env", vector_entry_point=f"{here}:map_vector_env")


for _function in (scenario_env, map_env):
    # Gymnasium looks here for the render modes, and wraps what it can make of them ("human", "rgb_array_list").
    vars(_function)["metadata"] = GoalEnv.metadata

_register()
