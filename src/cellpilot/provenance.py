"""Where a result came from."""

import hashlib
import os
import platform
from collections.abc import Iterable
from importlib.metadata import PackageNotFoundError, version

import numpy as np

from cellpilot import __version__

PACKAGES = ("jax", "equinox", "optax", "numpy", "scipy", "xarray")
"""Other packages whose version can change a number."""


def versions() -> dict[str, str]:
    """Versions of Python, cellpilot and the packages behind the numbers; a package that is not installed is left out."""
    found = {"python": platform.python_version(), "cellpilot": __version__}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def digest(arrays: Iterable[np.ndarray]) -> str:
    """First 16 hexadecimal digits of the SHA-256 over shapes, types and bytes of the arrays, in order."""
    sha = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        sha.update(f"{array.shape}{array.dtype.str}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()[:16]
