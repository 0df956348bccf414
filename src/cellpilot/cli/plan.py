"""`cellpilot plan MAP_OR_RUN --start ... --goal ...`: one route, without training where the policy needs none."""

import json
import sys
from collections.abc import Sequence
from typing import Annotated

import tyro
from pydantic import Field

from cellpilot.cli.console import out, warn
from cellpilot.cli.options import HELP, parse
from cellpilot.errors import InputError
from cellpilot.plan.route import Route
from cellpilot.scenario import AirspaceSettings, RewardSettings, Settings
from cellpilot.service import open_source, plan
from cellpilot.service.planning import BEST, Flyer
from cellpilot.world import World


class PlanOptions(Settings):
    """Options of `plan`."""

    source: tyro.conf.Positional[str] = Field("", description="map file, run folder or shipped scenario")
    start: str = Field("", description="cells 12,9,0, metres -50m,120m,30m, or degrees 3.1,101.7,30 (3deg,101deg,30m)")
    goal: str = Field("", description="like --start; write --goal=-50m,120m,30m if it begins with a minus")
    policy: Flyer = Field(BEST, description="who flies")
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = Field(False, description="print JSON and nothing else")
    task: RewardSettings = RewardSettings()
    airspace: AirspaceSettings = AirspaceSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `plan`; exit code 0 for a route that reaches the goal, 1 for one that loops or runs out of time."""
    wants_help = any(argument in HELP for argument in arguments)
    name = next((a for a in arguments if not a.startswith("-")), "")
    if not wants_help and (not name or arguments[0] != name):
        raise InputError(
            "a map file, a run folder or a shipped scenario comes first: cellpilot plan MAP_OR_RUN --start ... --goal ..."
        )
    source = None if wants_help else open_source(name, warn)
    default = PlanOptions(source=name)
    if source is not None:
        rewards = RewardSettings(**source.task.model_dump(include=set(RewardSettings.model_fields)))
        default = PlanOptions(source=name, task=rewards, airspace=source.airspace)
    options = parse(PlanOptions, arguments, "cellpilot plan", "Plan a route over a map.", default)
    assert source is not None
    for end in ("start", "goal"):
        if not getattr(options, end):
            raise InputError(f"--{end} is missing; {PlanOptions.model_fields[end].description}")
    found = plan(source, options.start, options.goal, options.policy, task=options.task, airspace=options.airspace, warn=warn)
    if options.as_json:
        sys.stdout.write(json.dumps(found.payload, indent=2) + "\n")
    else:
        _show(found.route, found.world)
    return 0 if found.route.status == "reached" else 1


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
