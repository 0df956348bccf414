"""NetCDF-4: everything a map holds, the same after reading as before writing."""

from pathlib import Path

from cellpilot.maps.schema import RadioMap, check_header, validate
from cellpilot.storage import check_seal, load_netcdf, save_netcdf


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as NetCDF-4."""
    # Encodings belong to the file a map was read from (chunks, fill values) and need not suit this one.
    save_netcdf(dataset.drop_encoding(), path, compress=True)


def read(path: Path) -> RadioMap:
    """The map in a NetCDF-4 file, in memory and checked; `InputError` names the file and what is wrong with it."""
    dataset = load_netcdf(path, "a map in NetCDF-4 written by cellpilot", lambda opened: check_header(opened, str(path)))
    return validate(dataset, str(path)).drop_encoding()


def has_checksum(path: Path) -> bool:
    """Whether the file ends with a checksum."""
    return check_seal(path)
