"""NetCDF-4: everything a map holds, the same after reading as before writing."""

from pathlib import Path

import numpy as np
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate
from cellpilot.provenance import write_atomically


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as NetCDF-4."""
    # Encodings belong to the file a map was read from (chunks, fill values) and need not suit this one.
    plain = dataset.drop_encoding()
    compressed = {name: {"zlib": True, "complevel": 4} for name in plain.data_vars}
    write_atomically(path, lambda temporary: plain.to_netcdf(temporary, engine="h5netcdf", encoding=compressed))


def read(path: Path) -> RadioMap:
    """The map in a NetCDF-4 file, in memory and checked; `InputError` names the file and what is wrong with it."""
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; expected a map in NetCDF-4: write it again")
    try:
        dataset = xr.load_dataset(path, engine="h5netcdf", decode_times=False, decode_timedelta=False)
    # Each layer below (HDF5, h5netcdf, xarray) has its own way to say that the bytes are not what they should be.
    except (OSError, ValueError, KeyError, RuntimeError, TypeError, AttributeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a readable NetCDF-4 file ({reason}); expected a map written by cellpilot") from None
    dataset.attrs = {name: value.item() if isinstance(value, np.generic) else value for name, value in dataset.attrs.items()}
    return validate(dataset, str(path)).drop_encoding()
