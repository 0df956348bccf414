"""Maps on disk, in the format that the end of the file's name says."""

from collections.abc import Callable
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate
from cellpilot.plugins import offered, refuse_taken


class Format(NamedTuple):
    """A file format: its module in `formats/`, and what a person calls it."""

    module: str
    name: str


MAP_FORMATS = {
    ".nc": Format("netcdf", "NetCDF-4"),
    ".zarr": Format("zarr", "Zarr (extra zarr)"),
    ".tif": Format("geotiff", "GeoTIFF (extra geo)"),
    ".tiff": Format("geotiff", "GeoTIFF (extra geo)"),
    ".csv": Format("csv_cells", "CSV, one line a cell"),
}
"""NetCDF and Zarr keep all of a map; GeoTIFF and CSV all variables over cells."""
SOURCES = "cellpilot.map_sources"
"""Entry points of other packages: ending without its dot -> what has `read(path)`, which returns a RadioMap."""


def save_map(dataset: RadioMap, path: str | Path, *, variable: str | None = None) -> None:
    """Write a map in the format of the file's name; the folder is made, and a failed write leaves nothing behind.

    `variable` is the only one that a GeoTIFF is to hold. `InputError` if the dataset is no valid RadioMap, the format is
    unknown or cannot hold it, or the place cannot be written.
    """
    path = Path(path)
    write: Callable[..., None] | None = getattr(_module(path), "write", None)
    if write is None:
        raise InputError(f"{path}: maps are read from {path.suffix}, but not written to it; expected {', '.join(MAP_FORMATS)}")
    if variable is not None:
        _check_raster(path, "one variable alone")
        write = partial(write, variable=variable)
    write(validate(dataset), path)


def load_map(path: str | Path, *, heights_m: tuple[float, ...] | None = None) -> RadioMap:
    """The map in a file, in memory and checked; `heights_m` are those of the bands of a GeoTIFF that does not say.

    `InputError` names the file and what is wrong with it.
    """
    path = Path(path)
    read: Callable[..., RadioMap] = _module(path).read
    if not path.exists():
        raise InputError(f"{path}: no such file; expected a map (.nc): make one with `cellpilot map`")
    if path.suffix.lower() != ".zarr" and not path.is_file():
        raise InputError(f"{path}: not a file; expected a map ({', '.join(MAP_FORMATS)})")
    if heights_m is not None:
        _check_raster(path, "heights of bands")
        read = partial(read, heights_m=heights_m)
    found = read(path)
    return found if path.suffix.lower() in MAP_FORMATS else validate(found, str(path))


def has_checksum(path: str | Path) -> bool:
    """Whether the file of a map holds a checksum, with which `load_map` compares what it reads."""
    check: Callable[[Path], bool] = getattr(_module(Path(path)), "has_checksum", lambda path: False)
    return check(Path(path))


def _check_raster(path: Path, option: str) -> None:
    found = MAP_FORMATS.get(path.suffix.lower())
    if found is None or found.module != "geotiff":
        raise InputError(f"{path}: {option} can be asked of GeoTIFF only: leave it out, or name a .tif")


def map_sources() -> dict[str, Any]:
    """What installed packages read maps with, by the ending of the file without its dot.

    `InputError` names one that has no `read`, or an ending that is ours.
    """
    found = {}
    for ending, (source, origin) in offered(SOURCES).items():
        refuse_taken(SOURCES, ending, origin, [suffix.removeprefix(".") for suffix in MAP_FORMATS])
        if not callable(getattr(source, "read", None)):
            raise InputError(f"the map source {ending} ({origin}) has no function read(path): remove it")
        found[ending] = source
    return found


def is_map(path: Path) -> bool:
    """Whether the file's name ends as that of a map."""
    return path.suffix.lower() in MAP_FORMATS or path.suffix.lower().removeprefix(".") in map_sources()


def _module(path: Path) -> Any:
    """A module of `formats/`, with `read(path)`, `write(map, path)` and `has_checksum(path)`, or what a package offers."""
    ending = path.suffix.lower()
    if ending in MAP_FORMATS:
        return import_module(f"cellpilot.maps.formats.{MAP_FORMATS[ending].module}")
    others = map_sources()
    if ending.removeprefix(".") in others:
        return others[ending.removeprefix(".")]
    known = ", ".join(f"{suffix} ({f.name})" for suffix, f in MAP_FORMATS.items())
    more = f", and with installed packages from {', '.join(f'.{name}' for name in others)}" if others else ""
    raise InputError(f"{path}: maps are read from and written to {known}{more}; choose one of these endings")
