"""NetCDF-4 files: made in memory and sealed, because HDF5 on a full disk ends the whole process."""

import gc
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cellpilot.errors import InputError
from cellpilot.memory import check_memory
from cellpilot.storage.atomic import write_atomically
from cellpilot.storage.seal import check_seal, seal

if TYPE_CHECKING:
    import xarray as xr

REMEDY = "take a smaller one, or a machine with more memory"


def save_netcdf(dataset: "xr.Dataset", path: Path, *, compress: bool = False) -> None:
    """Write a dataset with its checksum; `InputError` if NetCDF cannot hold it, `WriteError` if the file cannot be written."""
    encoding = {name: {"zlib": True, "complevel": 4} for name in dataset.data_vars} if compress else {}
    try:
        content = bytes(dataset.to_netcdf(engine="h5netcdf", encoding=encoding))
    except (TypeError, ValueError, AttributeError, UnicodeEncodeError) as error:
        raise InputError(f"{path}: NetCDF cannot hold {_culprit(dataset)} ({_one_line(error)}): change or remove it") from None
    write_atomically(path, seal(content))


def load_netcdf(path: Path, expected: str, check: "Callable[[xr.Dataset], None]" = lambda dataset: None) -> "xr.Dataset":
    """The dataset in a file, in memory; `expected` says what it should be, and `check` looks at it before it is read.

    `InputError` for a file that is missing, empty, damaged or of another format, and for one whose arrays do not fit into
    the memory there is.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected {expected}")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; expected {expected}")
    check_seal(path)
    with _quiet_half_made_objects():
        found = _read(path, check)
    if isinstance(found, str):
        raise InputError(f"{path}: not a readable NetCDF-4 file ({found}); expected {expected}")
    return found


def _read(path: Path, check: "Callable[[xr.Dataset], None]") -> "xr.Dataset | str":
    """The dataset, or why it cannot be read: an exception would keep the half-made objects alive."""
    import xarray as xr

    try:
        check_memory(2 * _axes_bytes(path), f"{path}: reading its axes", REMEDY)
        with xr.open_dataset(path, engine="h5netcdf", decode_times=False, decode_timedelta=False, cache=False) as opened:
            check(opened)
            check_memory(2 * opened.nbytes, f"{path}: reading it", REMEDY)
            return opened.load()
    except InputError:
        raise
    # Each layer below (HDF5, h5netcdf, xarray) has its own way to say that the bytes are not what they should be.
    except (OSError, ArithmeticError, AttributeError, LookupError, RuntimeError, SystemError, TypeError, ValueError) as error:
        reason = _one_line(error)
    gc.collect()
    return reason


def _axes_bytes(path: Path) -> int:
    """Size of all arrays of one dimension: xarray reads those that are axes as soon as it opens a file."""
    import h5py

    sizes: list[int] = []

    def visit(name: str, item: Any) -> None:
        if isinstance(item, h5py.Dataset) and len(item.shape or ()) == 1:
            sizes.append(item.shape[0] * item.dtype.itemsize)

    with h5py.File(path) as file:
        file.visititems(visit)
    return sum(sizes)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())[:120]


def _culprit(dataset: "xr.Dataset") -> str:
    """The first attribute that NetCDF has no type for; else the dataset."""
    import numpy as np

    for name, value in dataset.attrs.items():
        simple = isinstance(value, str | int | float | np.generic | np.ndarray) and not isinstance(value, bool)
        if not simple or (isinstance(value, str) and (not value.isprintable() and "\0" in value)):
            return f"the attribute {name} = {value!r:.60}"
        if isinstance(value, str):
            try:
                value.encode()
            except UnicodeEncodeError:
                return f"the attribute {name} = {value!r:.60}"
    return "the dataset"


@contextmanager
def _quiet_half_made_objects() -> Iterator[None]:
    """h5netcdf complains on standard error when it takes down a file that it could not open."""
    before, sys.unraisablehook = sys.unraisablehook, lambda unraisable: None
    try:
        yield
    finally:
        sys.unraisablehook = before
