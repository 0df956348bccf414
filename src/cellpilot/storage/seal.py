"""A checksum at the end of a file that others read as well: HDF5 and TIFF leave what follows their last byte alone.

It belongs to the file, not to its content: what another program makes of it has none, and is read without.
"""

import hashlib
from pathlib import Path

from cellpilot.errors import InputError

SEAL_MARK = b"\ncellpilot sha256 "
LENGTH = len(SEAL_MARK) + 64 + 1


def digest_of_bytes(content: bytes) -> str:
    """The SHA-256 of some bytes as 64 hexadecimal digits."""
    return hashlib.sha256(content).hexdigest()


def seal(content: bytes) -> bytes:
    """The content and its checksum."""
    return content + SEAL_MARK + digest_of_bytes(content).encode() + b"\n"


def check_seal(path: Path) -> bool:
    """Whether the file has a checksum; `InputError` if it has one of another content."""
    size = path.stat().st_size
    if size < LENGTH:
        return False
    with path.open("rb") as file:
        file.seek(size - LENGTH)
        tail = file.read()
        if not tail.startswith(SEAL_MARK):
            return False
        file.seek(0)
        sha, left = hashlib.sha256(), size - LENGTH
        while left > 0 and (block := file.read(min(left, 1 << 20))):
            sha.update(block)
            left -= len(block)
    if tail[len(SEAL_MARK) : -1] != sha.hexdigest().encode():
        raise InputError(
            f"{path}: checksum mismatch: the file is damaged, or another program changed it in place; restore or make it again;"
            " if you changed it yourself, save it under a new name with that program"
        )
    return True
