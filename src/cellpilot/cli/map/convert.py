"""`cellpilot map convert`: one file format into another."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.errors import InputError
from cellpilot.maps import load_map, save_map
from cellpilot.scenario import Floats, Settings

RASTERS = (".tif", ".tiff")


class ConvertOptions(Settings):
    """Options of `map convert`."""

    source: tyro.conf.Positional[Path] = Field(description="map to read (.nc, .zarr, .tif, .csv)", strict=False)
    out: tyro.conf.Positional[Path] = Field(description="map to write (.nc, .zarr, .tif, .csv)", strict=False)
    heights_m: Floats | None = Field(None, description="height of each band of a GeoTIFF that does not say [m]")
    variable: str = Field("sinr_db", description="variable that a GeoTIFF is to hold")


def main(arguments: Sequence[str]) -> int:
    """Read and write."""
    options = parse(ConvertOptions, arguments, "cellpilot map convert", "Turn a map into another format.")
    if options.heights_m is not None:
        if options.source.suffix.lower() not in RASTERS:
            raise InputError(f"--heights-m is for GeoTIFF, {options.source} states its heights: leave it out")
        from cellpilot.maps.formats.geotiff import read

        radio_map = read(options.source, options.heights_m)
    else:
        radio_map = load_map(options.source)
    if options.variable != "sinr_db":
        if options.out.suffix.lower() not in RASTERS:
            raise InputError(f"--variable is for GeoTIFF, {options.out} holds all variables: leave it out")
        from cellpilot.maps.formats.geotiff import write

        write(radio_map, options.out, options.variable)
    else:
        save_map(radio_map, options.out)
    out.print(f"map: {options.out}")
    return 0
