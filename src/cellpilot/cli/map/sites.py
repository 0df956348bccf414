"""`cellpilot map sites`: a site list to edit, of a scenario's deployment or of the positions in an OpenCelliD file."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse, refuse_idle
from cellpilot.errors import InputError
from cellpilot.experiment import make_sites
from cellpilot.maps import AssumedSectors, read_opencellid, write_sites
from cellpilot.scenario import Finite, Floats, Positive, Settings, SimulatedMap, find_scenario, load_scenario


class SitesOptions(Settings):
    """Options of `map sites`."""

    scenario: tyro.conf.Positional[str | None] = Field(
        None, description="TOML file or name of a shipped scenario; None = thesis-2d"
    )
    out: Path = Field(Path("sites.csv"), description="site list to write", strict=False)
    opencellid: Path | None = Field(None, description="OpenCelliD export: LTE positions of one operator instead", strict=False)
    operator: str | None = Field(None, description="operator in the OpenCelliD file, MCC-MNC")
    azimuths_deg: Floats = Field(
        AssumedSectors.azimuths_deg, description="assumed sector bearings of every OpenCelliD site [deg]"
    )
    height_m: Positive = Field(AssumedSectors.height_m, description="assumed antenna height [m]")
    electrical_tilt_deg: Finite = Field(AssumedSectors.electrical_tilt_deg, description="assumed downtilt [deg]")
    power_dbm: Finite = Field(AssumedSectors.power_dbm, description="assumed power of a sector [dBm]")
    carrier_hz: Positive = Field(AssumedSectors.carrier_hz, description="assumed carrier [Hz]")
    bandwidth_hz: Positive = Field(AssumedSectors.bandwidth_hz, description="assumed bandwidth [Hz]")
    load: float = Field(AssumedSectors.load, ge=0, le=1, description="assumed load (0..1)")


ASSUMED = ("azimuths_deg", "height_m", "electrical_tilt_deg", "power_dbm", "carrier_hz", "bandwidth_hz", "load")
"""Options that stand for what a list of positions does not say."""


def main(arguments: Sequence[str]) -> int:
    """Write the list."""
    options = parse(SitesOptions, arguments, "cellpilot map sites", "Write a site list.")
    if options.out.is_file():
        raise InputError(f"{options.out}: exists already, perhaps edited; choose another file with --out, or remove it")
    if options.opencellid is not None:
        if options.scenario is not None:
            raise InputError(f"{options.scenario} has no say in the positions of --opencellid FILE: leave one of them out")
        assumed = AssumedSectors(**{name: getattr(options, name) for name in ASSUMED})
        found = read_opencellid(options.opencellid, options.operator, assumed)
        write_sites(found.deployment, options.out, found.names, found.anchor, found.note)
        for line in found.account:
            out.print(line)
    else:
        refuse_idle(options, ("operator", *ASSUMED), "is for the positions of --opencellid FILE")
        scenario = options.scenario or "thesis-2d"
        settings = load_scenario(find_scenario(scenario)).map
        if not isinstance(settings, SimulatedMap):
            raise InputError(f"{scenario} has no deployment: its map is not simulated")
        sites = make_sites(settings)
        write_sites(sites.deployment, options.out, sites.names, sites.anchor)
    out.print(f"sites: {options.out}")
    return 0
