"""Zarr: everything a map holds, as a folder of chunks that cloud storage and dask read piece by piece (extra `zarr`)."""

import shutil
from pathlib import Path

import numpy as np
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap, validate
from cellpilot.storage import TEMPORARY

ASIDE = ".replaced-"
"""How the name of a store begins while another takes its place."""


def write(dataset: RadioMap, path: Path) -> None:
    """Write a valid map as a Zarr folder, in the place of one that is there."""
    _check_installed()
    if path.is_dir() and any(path.iterdir()) and not (path / ".zgroup").exists() and not (path / "zarr.json").exists():
        raise InputError(f"{path}: a folder that is no Zarr store; choose another name, it is not replaced")

    path = path.resolve()  # of a link, what it points at is replaced
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary, aside = path.with_name(TEMPORARY + path.name), path.with_name(ASIDE + path.name)
    try:
        dataset.drop_encoding().to_zarr(temporary, mode="w", consolidated=True, zarr_format=2)
        _replace(path, temporary, aside)
    finally:
        shutil.rmtree(temporary, ignore_errors=True)


def _replace(path: Path, temporary: Path, aside: Path) -> None:
    """Rename `temporary` to `path`; a kill at any time leaves the old store or the new one, whole, under `path` or `aside`."""
    if path.is_dir():
        # Without a store at `path`, the one aside would be the only one: a kill came between the two renames below.
        shutil.rmtree(aside, ignore_errors=True)
        path.rename(aside)
    try:
        temporary.rename(path)
    except BaseException:
        if aside.is_dir() and not path.exists():
            aside.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


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
