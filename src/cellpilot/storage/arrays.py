"""One NumPy array in a file, sealed: what a study keeps of the parts that are finished."""

import io
from pathlib import Path

import numpy as np

from cellpilot.errors import InputError
from cellpilot.storage.atomic import write_atomically
from cellpilot.storage.seal import check_seal, seal


def save_array(array: np.ndarray, path: Path) -> None:
    """Write the array with its checksum."""
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    write_atomically(path, seal(buffer.getvalue()))


def load_array(path: Path) -> np.ndarray:
    """The array in a file that `save_array` wrote; `InputError` for a damaged one."""
    try:
        if check_seal(path):
            return np.asarray(np.load(path, allow_pickle=False))
    except (ValueError, OSError, EOFError) as error:
        if isinstance(error, InputError):
            raise
    raise InputError(f"{path}: damaged, or no curve that cellpilot has saved; delete it, and it is made again")
