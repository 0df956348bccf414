"""`cellpilot map convert`: one file format into another."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse, refuse_overwriting
from cellpilot.maps import load_map, save_map
from cellpilot.scenario import Floats, Settings


class ConvertOptions(Settings):
    """Options of `map convert`."""

    source: tyro.conf.Positional[Path] = Field(description="map to read (.nc, .zarr, .tif, .csv)", strict=False)
    out: tyro.conf.Positional[Path] = Field(description="map to write (.nc, .zarr, .tif, .csv)", strict=False)
    heights_m: Floats | None = Field(None, description="height of each band of a GeoTIFF that does not say [m]")
    variable: str | None = Field(None, description="the only variable that a GeoTIFF is to hold; default: all over cells")


def main(arguments: Sequence[str]) -> int:
    """Read and write."""
    options = parse(ConvertOptions, arguments, "cellpilot map convert", "Turn a map into another format.")
    refuse_overwriting(options.out, (options.source,))
    save_map(load_map(options.source, heights_m=options.heights_m), options.out, variable=options.variable)
    out.print(f"map: {options.out}")
    return 0
