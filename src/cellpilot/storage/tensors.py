"""Safetensors files with a JSON header of ours and a checksum over both."""

import hashlib
import json
from collections.abc import Mapping, Set
from pathlib import Path
from typing import Any

import numpy as np
from safetensors import SafetensorError, safe_open
from safetensors.numpy import save

from cellpilot.errors import InputError
from cellpilot.storage.atomic import write_atomically
from cellpilot.storage.texts import parse_json


def save_tensors(path: Path, tensors: Mapping[str, np.ndarray], kind: str, header: Mapping[str, Any]) -> None:
    """Write tensors and header; `kind` names the format. `WriteError` if the file cannot be written."""
    whole = {name: np.asarray(value, order="C") for name, value in tensors.items()}
    # One entry: safetensors writes several in any order, and equal trainings shall give equal files.
    metadata = {kind: json.dumps({**header, "digest": _digest(whole, header)})}
    write_atomically(path, save(whole, metadata=metadata))


def load_tensors(path: Path, kind: str, keys: Set[str], remedy: str) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
    """Tensors and header of a file of that kind, whose header has these keys; without `digest` it was written without a checksum.

    `InputError`, which ends with `remedy`, for a missing or damaged file, one of another kind, or one whose checksum is that of
    another content.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such file; {remedy}")
    try:
        with safe_open(path, framework="np") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    # NumPy has not every type that safetensors has (bfloat16, float8), and says so in its own ways.
    except (SafetensorError, OSError, ValueError, TypeError, KeyError, AttributeError) as error:
        raise InputError(f"{path}: not a readable safetensors file ({' '.join(str(error).split())[:120]}); {remedy}") from None
    if kind not in metadata:
        raise InputError(f"{path}: no entry {kind!r} in its header; {remedy}")
    header = parse_json(metadata[kind], f"{path}, header {kind!r}", remedy)
    if header.keys() - {"digest"} != keys:
        raise InputError(f"{path}: its header has {', '.join(header) or 'nothing'}; expected {', '.join(sorted(keys))}; {remedy}")
    if "digest" in header and header["digest"] != _digest(tensors, header):
        raise InputError(f"{path}: checksum mismatch: the file is damaged, or was changed; {remedy}")
    return tensors, header


def _digest(tensors: Mapping[str, np.ndarray], header: Mapping[str, Any]) -> str:
    """SHA-256 over the header without the digest, and over names, types, shapes and bytes of the tensors by name."""
    about = {name: value for name, value in header.items() if name != "digest"}
    sha = hashlib.sha256(json.dumps(about, sort_keys=True).encode())
    for name in sorted(tensors):
        array = np.asarray(tensors[name], order="C")
        sha.update(f"{name} {array.dtype.str} {array.shape}".encode())
        sha.update(array.tobytes())
    return sha.hexdigest()
