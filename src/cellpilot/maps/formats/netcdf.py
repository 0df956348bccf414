"""NetCDF-4: everything a map holds, the same after reading as before writing."""

from pathlib import Path

import numpy as np

from cellpilot.maps.schema import RadioMap, validate
from cellpilot.storage import load_netcdf, save_netcdf


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as NetCDF-4."""
    # Encodings belong to the file a map was read from (chunks, fill values) and need not suit this one.
    save_netcdf(dataset.drop_encoding(), path, compress=True)


def read(path: Path) -> RadioMap:
    """The map in a NetCDF-4 file, in memory and checked; `InputError` names the file and what is wrong with it."""
    dataset = load_netcdf(path, "a map in NetCDF-4 written by cellpilot")
    dataset.attrs = {name: value.item() if isinstance(value, np.generic) else value for name, value in dataset.attrs.items()}
    return validate(dataset, str(path)).drop_encoding()
