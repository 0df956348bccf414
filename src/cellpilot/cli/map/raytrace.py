"""`cellpilot map raytrace --scene munich`: a map by ray tracing with Sionna RT."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from pydantic import Field

from cellpilot.cli.console import out, share_bar
from cellpilot.cli.options import parse, refuse_idle, refuse_overwriting
from cellpilot.errors import InputError
from cellpilot.experiment import make_sites
from cellpilot.maps import save_map
from cellpilot.maps.sources.raytraced import Rays, raytrace_map
from cellpilot.maps.sources.simulated import bin_centres
from cellpilot.maps.words import blocked_words
from cellpilot.scenario import Count, Settings, SimulatedMap


class RaytraceOptions(Settings):
    """Options of `map raytrace`."""

    scene: str = Field("munich", description="scene of Sionna RT, or a Mitsuba XML file")
    out: Path = Field(Path("map.nc"), description="RadioMap file to write", strict=False)
    rays: Count = Field(Rays.rays, description="rays of each sector at each height")
    reflections: int = Field(Rays.reflections, ge=0, description="interactions of a ray, at most")
    diffuse: bool = Field(Rays.diffuse, description="diffuse reflection")
    diffraction: bool = Field(Rays.diffraction, description="diffraction")
    seed: int = Field(Rays.seed, ge=0, description="seed of the rays")
    map: SimulatedMap = Field(SimulatedMap(), description="area, heights, bins and deployment or site list in the scene's metres")


IDLE = ("environment", "los", "shadowing_seed", "points_per_side", "array_factor_floor_db")
"""Settings of the simulation that no ray asks for."""


def main(arguments: Sequence[str]) -> int:
    """Trace and write."""
    options = parse(RaytraceOptions, arguments, "cellpilot map raytrace", "Make a map by ray tracing.")
    refuse_overwriting(options.out, (options.map.sites,))
    refuse_idle(options.map, IDLE, "is for the 3GPP simulation, not for ray tracing", "map.")
    sites = make_sites(options.map)
    if sites.in_degrees and options.map.anchor is None:
        raise InputError(
            f"{options.map.sites} is in degrees, the scene in metres: say where x = y = 0 of the scene lies: --map.anchor LAT LON"
        )
    names = ("rays", "reflections", "diffuse", "diffraction", "seed")
    with share_bar("trace") as progress:
        radio_map = raytrace_map(
            sites.deployment,
            options.scene,
            x_m=bin_centres("x", options.map.x_range_m, options.map.bin_m),
            y_m=bin_centres("y", options.map.y_range_m, options.map.bin_m),
            heights_m=options.map.heights_m,
            rays=Rays(**{name: getattr(options, name) for name in names}),
            names=sites.names,
            anchor=sites.anchor,
            progress=progress,
        )
    save_map(radio_map, options.out)
    raised = (radio_map["sector_height_m"].values > sites.deployment.height_m + 1e-9).sum()
    out.print(f"map: {options.out}; {blocked_words(radio_map)}")
    if raised:
        out.print(f"{raised} of {len(np.atleast_1d(sites.deployment.x_m))} sectors raised above the roof they would stand under")
    return 0
