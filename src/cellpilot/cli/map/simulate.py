"""`cellpilot map simulate`: the map of a scenario's deployment or of a site list."""

import re
from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out, share_bar, warn
from cellpilot.cli.options import THESIS, parse, refuse_overwriting, scenario_argument
from cellpilot.errors import InputError
from cellpilot.experiment import build_map, layout_warning, make_sites
from cellpilot.maps import save_map
from cellpilot.scenario import MapSettings, Scenario, Settings, SimulatedMap


class SimulateOptions(Settings):
    """Options of `map simulate`."""

    scenario: tyro.conf.Positional[str] = Field(THESIS, description="TOML file or name of a shipped scenario")
    out: Path = Field(Path("map.nc"), description="RadioMap file to write (.nc, .zarr, .tif, .csv)", strict=False)
    map: MapSettings = SimulatedMap()


def main(arguments: Sequence[str]) -> int:
    """Simulate and write."""
    arguments = [re.sub(r"^--sites(?=$|=)", "--map.sites", argument) for argument in arguments]
    given = any(argument.split("=")[0] == "--map.sites" for argument in arguments)
    # A scenario is the base of the settings; with a site list the thesis's is as good as any.
    found = scenario_argument([*arguments, "thesis-2d"] if given and arguments[0].startswith("-") else arguments)
    name, scenario = found if found else ("thesis-2d", Scenario())
    default = SimulateOptions(scenario=name, map=scenario.map)
    options = parse(SimulateOptions, arguments, "cellpilot map simulate", "Make the map of a scenario.", default)
    if options.scenario != name:
        raise InputError(f"{options.scenario}: no scenario of that name; expected a TOML file or the name of a shipped scenario")
    if not isinstance(options.map, SimulatedMap):
        raise InputError(f"{name} has no simulated map; import its logs instead: cellpilot map import")
    refuse_overwriting(options.out, (options.map.sites,))
    with share_bar("simulate") as progress:
        save_map(build_map(options.map, progress=progress), options.out)
    out.print(f"map: {options.out}")
    warn(layout_warning(make_sites(options.map).deployment, options.map))
    return 0
