"""`cellpilot map simulate | import | info | show`: radio maps without any learning."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import tyro
from pydantic import Field

from cellpilot.cli.console import out, warn
from cellpilot.cli.options import parse, scenario_argument
from cellpilot.errors import InputError
from cellpilot.experiment import make_map, threshold_warning
from cellpilot.maps import account_of, import_logs, load_map, save_map
from cellpilot.scenario import MapSettings, Scenario, Settings, SimulatedMap
from cellpilot.world import World


class SimulateOptions(Settings):
    """Options of `map simulate`."""

    scenario: tyro.conf.Positional[str] = Field("thesis-2d", description="TOML file or name of a shipped scenario")
    out: Path = Field(Path("map.nc"), description="RadioMap file to write", strict=False)
    map: MapSettings = SimulatedMap()


class ImportOptions(Settings):
    """Options of `map import`."""

    logs: tyro.conf.Positional[tuple[str, ...]] = Field(description="log files; several files = several heights", strict=False)
    out: Path = Field(Path("map.nc"), description="RadioMap file to write", strict=False)
    altitude: float | None = Field(None, ge=0, description="height of the logs [m]; None = read from the file names")
    bin_m: float = Field(40.0, gt=0, description="side of a cell [m]")
    fill_radius_m: float = Field(80.0, ge=0, description="fill holes from neighbours within [m]; 0 = leave holes")
    mask: str | None = Field(None, description="LAT,LON,RADIUS_M to leave out, or none; None = the hover at take-off, if any")
    unknown: Literal["blocked", "bad"] = Field("blocked", description="what an unknown cell is: not to be entered, or bad signal")


class InfoOptions(Settings):
    """Options of `map info`."""

    file: tyro.conf.Positional[Path] = Field(description="RadioMap file", strict=False)
    threshold_db: float = Field(3.0, allow_inf_nan=False, description="SINR threshold [dB]")


class ShowOptions(Settings):
    """Options of `map show`."""

    file: tyro.conf.Positional[Path] = Field(description="RadioMap file", strict=False)
    out: Path | None = Field(None, description="picture to write (png, pdf or svg); default beside the map", strict=False)
    threshold_db: float = Field(3.0, allow_inf_nan=False, description="SINR threshold [dB]")


def main(arguments: Sequence[str]) -> int:
    """Verb `map` and its four actions."""
    actions = {"simulate": _simulate, "import": _import, "info": _info, "show": _show}
    if not arguments or arguments[0] not in actions:
        asked = not arguments or arguments[0] in ("-h", "--help")
        text = f"cellpilot map {' | '.join(actions)} ...  (cellpilot map ACTION --help)"
        if not asked:
            raise InputError(f"unknown action {arguments[0]!r}; {text}")
        out.print(f"usage: {text}")
        return 0
    return actions[arguments[0]](arguments[1:])


def _simulate(arguments: Sequence[str]) -> int:
    found = scenario_argument(arguments)
    name, scenario = found if found else ("thesis-2d", Scenario())
    default = SimulateOptions(scenario=name, map=scenario.map)
    options = parse(SimulateOptions, arguments, "cellpilot map simulate", "Make the map of a scenario.", default)
    save_map(make_map(options.map), options.out)
    out.print(f"map: {options.out}")
    return 0


def _import(arguments: Sequence[str]) -> int:
    options = parse(ImportOptions, arguments, "cellpilot map import", "Grid measured logs into a map.")
    radio_map = import_logs(
        options.logs,
        altitude_m=options.altitude,
        bin_m=options.bin_m,
        fill_radius_m=options.fill_radius_m,
        mask=_mask(options.mask),
        unknown=options.unknown,
    )
    save_map(radio_map, options.out)
    for line in account_of(radio_map).lines():
        out.print(line)
    out.print(f"map: {options.out}")
    return 0


def _mask(text: str | None) -> str | tuple[float, float, float] | None:
    if text is None:
        return "auto"
    if text == "none":
        return None
    try:
        latitude_deg, longitude_deg, radius_m = (float(part) for part in text.split(","))
    except ValueError as error:
        raise InputError(f"--mask is {text!r}; expected LAT,LON,RADIUS_M like 2.92284,101.77107,25, or none") from error
    return latitude_deg, longitude_deg, radius_m


def _info(arguments: Sequence[str]) -> int:
    options = parse(InfoOptions, arguments, "cellpilot map info", "What a map holds.")
    radio_map = load_map(options.file)
    world = World.from_map(radio_map)
    sides = " x ".join(map(str, world.grid.sides))
    out.print(f"{options.file}: {sides} cells, source {radio_map.attrs['source']}, {radio_map.attrs.get('model') or 'no model'}")
    layers = [column.reshape(len(world.grid.z_m), -1) for column in (world.sinr_db, ~world.blocked)]
    for z_m, sinr_db, free in zip(world.grid.z_m, *layers, strict=True):
        radio = "nothing known"
        if free.any():
            low = (sinr_db[free] < options.threshold_db).mean()
            radio = f"{low:.1%} below {options.threshold_db:g} dB, median {np.median(sinr_db[free]):.1f} dB"
        out.print(f"  {z_m:g} m: {free.sum()} free cells, {(~free).sum()} blocked, {radio}")
    for line in account_of(radio_map).lines() if "import_account" in radio_map.attrs else []:
        out.print(f"  {line}")
    warn(threshold_warning(world, options.threshold_db))
    return 0


def _show(arguments: Sequence[str]) -> int:
    options = parse(ShowOptions, arguments, "cellpilot map show", "Draw a map.")
    from cellpilot.report.figures import save_figure
    from cellpilot.report.maps import sinr_map_figure

    radio_map = load_map(options.file)
    path = options.out or options.file.with_suffix(".png")
    save_figure(sinr_map_figure(radio_map, options.threshold_db), path)
    out.print(f"picture: {path}")
    return 0
