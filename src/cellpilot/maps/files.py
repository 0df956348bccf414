"""Maps on disk, in the format that the end of the file's name says."""

from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import NamedTuple

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate


class Format(NamedTuple):
    """A file format: its module in `formats/`, and what a person calls it."""

    module: str
    name: str


FORMATS = {
    ".nc": Format("netcdf", "NetCDF-4"),
    ".zarr": Format("zarr", "Zarr (extra zarr)"),
    ".tif": Format("geotiff", "GeoTIFF (extra geo)"),
    ".tiff": Format("geotiff", "GeoTIFF (extra geo)"),
    ".csv": Format("csv_cells", "CSV, one line a cell"),
}
"""NetCDF and Zarr keep all of a map; GeoTIFF keeps one variable, CSV all variables over cells."""


def save_map(dataset: RadioMap, path: str | Path) -> None:
    """Write a map in the format of the file's name; the folder is made, and a failed write leaves nothing behind.

    `InputError` if the dataset is no valid RadioMap, the format is unknown or cannot hold it, or the place cannot be written.
    """
    path = Path(path)
    write: Callable[[RadioMap, Path], None] = _module(path).write
    try:
        write(validate(dataset), path)
    except OSError as error:
        raise InputError(
            f"{path}: cannot write the map ({error.strerror or error}): choose another folder or file name"
        ) from None


def load_map(path: str | Path) -> RadioMap:
    """The map in a file, in memory and checked; `InputError` names the file and what is wrong with it."""
    path = Path(path)
    read: Callable[[Path], RadioMap] = _module(path).read
    if not path.exists():
        raise InputError(f"{path}: no such file; expected a map (.nc): make one with `cellpilot map`")
    if path.suffix.lower() != ".zarr" and not path.is_file():
        raise InputError(f"{path}: not a file; expected a map ({', '.join(FORMATS)})")
    return read(path)


def _module(path: Path) -> ModuleType:
    """A module of `formats/`, with `read(path)` and `write(map, path)`."""
    found = FORMATS.get(path.suffix.lower())
    if found is None:
        known = ", ".join(f"{suffix} ({f.name})" for suffix, f in FORMATS.items())
        raise InputError(f"{path}: maps are read from and written to {known}; choose one of these endings")
    return import_module(f"cellpilot.maps.formats.{found.module}")
