"""One route over whatever has a map."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cellpilot.errors import InputError
from cellpilot.experiment import make_task, make_world, threshold_warning
from cellpilot.grid import Position
from cellpilot.maps import RadioMap, anchor_of, to_degrees, to_local
from cellpilot.plan.route import Route, parse_place, plan_route, route_payload
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy
from cellpilot.runs import Run
from cellpilot.scenario import AirspaceSettings, RewardSettings
from cellpilot.service.callbacks import Warn, as_warning, tell
from cellpilot.service.sources import Source, open_source
from cellpilot.task import Task
from cellpilot.world import World

Flyer = Literal["optimal", "greedy", "learned"]
BEST: Flyer = "optimal"
"""Who flies if nobody is named."""


@dataclass(frozen=True)
class Planned:
    """A route and the world and map that it leads through."""

    route: Route
    world: World
    radio_map: RadioMap

    @property
    def payload(self) -> dict[str, Any]:
        """The route as plain data for JSON: summary and one entry for each cell, with degrees where the map is anchored."""
        anchor = anchor_of(self.radio_map)
        degrees = None if anchor is None else lambda x_m, y_m: to_degrees(x_m, y_m, anchor)
        return route_payload(self.route, self.world, degrees)


def plan(
    source: Source | Run | str | Path,
    start: str | Position,
    goal: str | Position,
    policy: Flyer = BEST,
    *,
    task: RewardSettings | None = None,
    airspace: AirspaceSettings | None = None,
    warn: Warn = as_warning,
) -> Planned:
    """The route of a policy between two places, given as cells `(ix, iy, iz)` or as text (see `parse_place`).

    `task` and `airspace` take the place of the source's own. The optimal route is that for discount 1: with less, circling
    where the signal is good can be worth more than a far goal. `InputError` names the argument that cannot be used.
    """
    opened = source if isinstance(source, Source) else open_source(source, warn)
    settings = task or opened.task
    world = make_world(opened.radio_map, settings.noise_std_db, airspace or opened.airspace)
    priced = make_task(settings, world.grid)
    anchor = anchor_of(opened.radio_map)
    local = None if anchor is None else lambda latitude_deg, longitude_deg: to_local(latitude_deg, longitude_deg, anchor)
    ends = {"start": start, "goal": goal}
    first, last = (
        parse_place(place, f"`{name}`", world, local) if isinstance(place, str) else _position(place, f"`{name}`", world)
        for name, place in ends.items()
    )
    flyer = _policy(opened, policy, world, priced)
    tell(warn, threshold_warning(world, priced.threshold_db))
    return Planned(plan_route(world, priced, flyer, first, last), world, opened.radio_map)


def _position(place: Position, what: str, world: World) -> Position:
    if not isinstance(place, tuple) or not all(isinstance(index, int | np.integer) for index in place):
        raise InputError(f"{what} is {place!r}; expected three cells like (12, 9, 0), or text")
    return world.grid.check_position(place, what)


def _policy(source: Source, name: str, world: World, task: Task) -> Policy:
    if name == "optimal":
        return OptimalPolicy(world, task, 1.0)
    if name == "greedy":
        return GreedyPolicy(world)
    if name != "learned":
        raise InputError(f"`policy` is {name!r}; expected optimal, greedy or learned")
    if source.parameters is None:
        raise InputError(f"{source.name} holds no trained policy; train first, or use `policy` optimal or greedy")
    source.parameters.check_airspace(world.airspace)
    return LearnedPolicy(source.parameters, world.grid)
