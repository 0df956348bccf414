"""Where a result came from, and writing files so that a half-written one never stays."""

import hashlib
import os
import platform
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import numpy as np

PACKAGES = ("cellpilot", "jax", "equinox", "optax", "numpy", "scipy", "xarray")
"""Packages whose version can change a number."""


def versions() -> dict[str, str]:
    """Versions of Python and of the packages behind the numbers; a package that is not installed is left out."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def digest(arrays: Iterable[np.ndarray]) -> str:
    """First 16 hexadecimal digits of the SHA-256 over shapes, types and bytes of the arrays, in order."""
    sha = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        sha.update(f"{array.shape}{array.dtype.str}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()[:16]


TEMPORARY = ".partial-"
"""How the name of a file begins while it is being written."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call `write(temporary)` on a file beside `path`, flush it to disk and rename it into place.

    The folder is made if missing. If `write` fails, the temporary file goes and `path` stays as it was; one that a kill
    left behind is overwritten the next time.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(TEMPORARY + path.name)
    try:
        write(temporary)
        with temporary.open("rb") as file:
            os.fsync(file.fileno())
        temporary.chmod(0o644)  # some writers make private files
        temporary.replace(path)
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise
