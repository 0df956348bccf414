"""One command at a time in a folder."""

import os
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from cellpilot.errors import InputError, WriteError
from cellpilot.storage.atomic import NO_FOLLOW, lock

LOCK = ".in-use"
"""File that holds the process id of the command that works in the folder; it goes when the command ends."""


@contextmanager
def hold(folder: Path) -> Iterator[None]:
    """Keep other commands out of the folder, which is made if missing; one that is made and stays empty goes again.

    `InputError` names the process that has the folder. A lock that a kill left behind is taken over.
    """
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: a file; choose an empty folder or a free name")
    missing = [place for place in (folder, *folder.parents) if not place.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _take(folder)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        _remove_empty(missing)
        if isinstance(error, InputError):
            raise
        raise WriteError(f"{folder}: cannot be worked in ({reason}); choose another folder") from None
    try:
        yield
    finally:
        (folder / LOCK).unlink(missing_ok=True)
        os.close(descriptor)
        _remove_empty(missing)


def _take(folder: Path) -> int:
    path = folder / LOCK
    while True:
        descriptor = os.open(path, os.O_RDWR | os.O_CREAT | NO_FOLLOW, 0o666)
        if not lock(descriptor):
            holder = os.read(descriptor, 20).decode("ascii", "replace").strip() or "another"
            os.close(descriptor)
            raise InputError(f"{folder} is in use by process {holder}: wait until it has ended, or choose another folder")
        # The one that had it may have taken the file away in between.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.stat(path), os.fstat(descriptor)):
                with suppress(OSError):  # a full disk: the lock holds without the number, and what is written next says so
                    os.truncate(descriptor, 0)
                    os.write(descriptor, f"{os.getpid()}\n".encode())
                return descriptor
        os.close(descriptor)


def _remove_empty(folders: list[Path]) -> None:
    """Take away folders without anything in them, the innermost first."""
    with suppress(OSError):
        for folder in folders:
            folder.rmdir()
