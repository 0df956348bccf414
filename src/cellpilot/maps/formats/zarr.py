"""Zarr: everything a map holds, as a folder of chunks that cloud storage and dask read piece by piece (extra `zarr`)."""

import os
import shutil
from pathlib import Path

import numpy as np
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as a Zarr folder, in the place of one that is there."""
    _check_installed()
    if path.is_dir() and any(path.iterdir()) and not (path / ".zgroup").exists() and not (path / "zarr.json").exists():
        raise InputError(f"{path}: a folder that is no Zarr store; choose another name, it is not replaced")

    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        dataset.drop_encoding().to_zarr(temporary, mode="w", consolidated=True, zarr_format=2)
        if path.is_dir():
            shutil.rmtree(path)
        os.replace(temporary, path)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def read(path: Path) -> RadioMap:
    """The map in a Zarr folder, in memory and checked."""
    _check_installed()
    try:
        dataset = xr.open_zarr(path, decode_times=False, decode_timedelta=False).load()
    except (OSError, ValueError, KeyError, RuntimeError, TypeError) as error:
        reason = " ".join(str(error).split())[:120]
        raise InputError(f"{path}: not a readable Zarr store ({reason}); expected a map written by cellpilot") from None
    dataset.attrs = {name: value.item() if isinstance(value, np.generic) else value for name, value in dataset.attrs.items()}
    return validate(dataset, str(path)).drop_encoding()


def _check_installed() -> None:
    try:
        import zarr  # noqa: F401
    except ImportError:
        raise InputError("Zarr files need the package zarr: pip install 'cellpilot[zarr]'") from None
