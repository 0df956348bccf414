"""Maps on disk: NetCDF-4, the same after reading as before writing."""

from pathlib import Path

import numpy as np
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate
from cellpilot.provenance import write_atomically


def save_map(dataset: RadioMap, path: str | Path) -> None:
    """Write a map as NetCDF-4; the folder is made, and a failed write leaves nothing behind.

    `InputError` if the dataset is no valid RadioMap or the place cannot be written.
    """
    path = Path(path)
    # Encodings belong to the file a map was read from (chunks, fill values) and need not suit this one.
    checked = validate(dataset).drop_encoding()
    compressed = {name: {"zlib": True, "complevel": 4} for name in checked.data_vars}
    try:
        write_atomically(path, lambda temporary: checked.to_netcdf(temporary, engine="h5netcdf", encoding=compressed))
    except OSError as error:
        raise InputError(
            f"{path}: cannot write the map ({error.strerror or error}): choose another folder or file name"
        ) from None


def load_map(path: str | Path) -> RadioMap:
    """The map in a NetCDF-4 file, in memory and checked; `InputError` names the file and what is wrong with it."""
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file; expected a map (.nc): make one with `cellpilot map`")
    if not path.is_file():
        raise InputError(f"{path}: not a file; expected a map (.nc)")
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
