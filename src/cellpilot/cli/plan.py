"""`cellpilot plan MAP_OR_RUN --start ... --goal ...`: one route, without training where the policy needs none."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import tyro
from pydantic import Field

from cellpilot.cli.console import out, warn
from cellpilot.cli.options import HELP, parse
from cellpilot.errors import InputError
from cellpilot.experiment import build_map, make_task, make_world, shipped_policy, threshold_warning
from cellpilot.maps import RadioMap, anchor_of, load_map, to_degrees, to_local
from cellpilot.plan.route import Route, parse_place, plan_route, route_payload
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy, PolicyParameters
from cellpilot.runs import open_run, origin_warning
from cellpilot.scenario import SHIPPED, AirspaceSettings, RewardSettings, Settings, find_scenario, load_scenario
from cellpilot.world import World


class PlanOptions(Settings):
    """Options of `plan`."""

    source: tyro.conf.Positional[str] = Field("", description="map file, run folder or shipped scenario")
    start: str = Field("", description="cells 12,9,0, metres -50m,120m,30m, or degrees 3.1,101.7,30 (3deg,101deg,30m)")
    goal: str = Field("", description="like --start; write --goal=-50m,120m,30m if it begins with a minus")
    policy: Literal["optimal", "greedy", "learned"] = Field("optimal", description="who flies")
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = Field(False, description="print JSON and nothing else")
    task: RewardSettings = RewardSettings()
    airspace: AirspaceSettings = AirspaceSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `plan`; exit code 0 for a route that reaches the goal, 1 for one that loops or runs out of time.

    The optimal route is that for discount 1: with less, circling where the signal is good can be worth more than a far goal.
    """
    wants_help = any(argument in HELP for argument in arguments)
    source = next((a for a in arguments if not a.startswith("-")), "")
    if not wants_help and (not source or arguments[0] != source):
        raise InputError(
            "a map file, a run folder or a shipped scenario comes first: cellpilot plan MAP_OR_RUN --start ... --goal ..."
        )
    loaded = None if wants_help else _load(source)
    task_settings, airspace = (RewardSettings(), AirspaceSettings()) if loaded is None else loaded[1:3]
    rewards = RewardSettings(**task_settings.model_dump(include=set(RewardSettings.model_fields)))
    default = PlanOptions(source=source, task=rewards, airspace=airspace)
    description = "Plan a route over a map."
    options = parse(PlanOptions, arguments, "cellpilot plan", description, default)
    assert loaded is not None
    radio_map, _, _, parameters = loaded
    world = make_world(radio_map, options.task.noise_std_db, options.airspace)
    task = make_task(options.task, world.grid)
    anchor = anchor_of(radio_map)
    local = None if anchor is None else lambda latitude_deg, longitude_deg: to_local(latitude_deg, longitude_deg, anchor)
    degrees = None if anchor is None else lambda x_m, y_m: to_degrees(x_m, y_m, anchor)
    for name in ("start", "goal"):
        if not getattr(options, name):
            raise InputError(f"--{name} is missing; {PlanOptions.model_fields[name].description}")
    start = parse_place(options.start, "--start", world, local)
    goal = parse_place(options.goal, "--goal", world, local)
    if options.policy == "learned" and parameters is None:
        raise InputError(f"{source} holds no trained policy; train first, or use --policy optimal or greedy")
    warn(threshold_warning(world, task.threshold_db))
    policies: dict[str, Policy] = {"optimal": OptimalPolicy(world, task, 1.0), "greedy": GreedyPolicy(world)}
    if parameters is not None:
        parameters.check_airspace(world.airspace)
        policies["learned"] = LearnedPolicy(parameters, world.grid)
    route = plan_route(world, task, policies[options.policy], start, goal)
    if options.as_json:
        sys.stdout.write(json.dumps(route_payload(route, world, degrees), indent=2) + "\n")
    else:
        _show(route, world)
    return 0 if route.status == "reached" else 1


def _load(source: str) -> tuple[RadioMap, RewardSettings, AirspaceSettings, PolicyParameters | None]:
    """Map, settings of task and airspace, and learned policy of what the person named."""
    path = Path(source)
    if path.is_dir():
        run = open_run(path)
        parameters = run.parameters()
        if parameters is not None:
            warn(origin_warning(parameters, run.radio_map, run.task, run.seed))
        return run.radio_map, run.scenario.task, run.scenario.airspace, parameters
    if path.suffix == ".toml" or (SHIPPED / f"{source}.toml").is_file():
        file = find_scenario(source)
        scenario = load_scenario(file)
        return build_map(scenario.map), scenario.task, scenario.airspace, shipped_policy(file)
    return load_map(path), RewardSettings(), AirspaceSettings(), None


def _show(route: Route, world: World) -> None:
    position, metres = world.grid.position(route.cells), world.grid.metres(route.cells)
    for (ix, iy, iz), (x_m, y_m, z_m), low, sinr_db in zip(position, metres, route.low_probability, route.sinr_db, strict=True):
        level = "unknown" if sinr_db is None else f"{sinr_db:6.1f} dB"
        out.print(f"  ({ix:2d},{iy:2d},{iz:2d})  {x_m:8.1f} {y_m:8.1f} {z_m:6.1f} m  {level}  P(low) {low:.2f}")
    out.print(
        f"{route.policy}: {route.status} after {route.n_steps} steps ({route.length_m:.0f} m, "
        f"shortest {route.shortest_steps} steps), {route.expected_low_share:.1%} of the steps below the threshold expected, "
        f"expected return {route.expected_return:.2f}"
    )
