"""Writing a folder so that a half-written one never stays, and two writers of one name do not hurt each other."""

import os
import secrets
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellpilot.storage.atomic import TEMPORARY, complaints, lock

ASIDE = ".replaced-"
"""How the name of a folder begins while another takes its place."""


@contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """An empty folder beside `path` that takes its place at the end of the block; what was there goes.

    `WriteError` as `write_atomically` gives it, and nothing stays of the new folder. A kill leaves the old folder or the new
    one, whole, under `path` or beside it as `ASIDE` and its name; what else it leaves goes with the next write to the name.
    """
    with complaints(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        _remove_leftovers(path)
        temporary, held = _create_beside(path)
        try:
            yield temporary
            with _one_at_a_time(path.parent):
                _replace(path, temporary)
        finally:
            os.close(held)
            shutil.rmtree(temporary, ignore_errors=True)


def _create_beside(path: Path) -> tuple[Path, int]:
    """A new, locked folder of a name that nobody else has; another writer may have taken one for a leftover before the lock."""
    while True:
        temporary = path.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-{path.name}")
        temporary.mkdir()
        try:
            held = os.open(temporary, os.O_RDONLY)
        except FileNotFoundError:
            continue
        if lock(held) and temporary.exists():
            return temporary, held
        os.close(held)


def _replace(path: Path, temporary: Path) -> None:
    aside = path.with_name(ASIDE + path.name)
    if path.is_dir():
        # Without a folder at `path`, the one aside would be the only one: a kill came between the two renames below.
        shutil.rmtree(aside, ignore_errors=True)
        path.rename(aside)
    try:
        temporary.rename(path)
    except BaseException:
        if aside.is_dir() and not path.exists():
            aside.rename(path)
        raise
    shutil.rmtree(aside, ignore_errors=True)


def _remove_leftovers(path: Path) -> None:
    for entry in path.parent.iterdir():
        if entry.name.startswith(TEMPORARY) and entry.name.endswith(f"-{path.name}") and entry.is_dir():
            try:
                held = os.open(entry, os.O_RDONLY)
            except OSError:
                continue  # renamed or removed in between
            try:
                if lock(held):
                    shutil.rmtree(entry, ignore_errors=True)
            finally:
                os.close(held)


@contextmanager
def _one_at_a_time(folder: Path) -> Iterator[None]:
    """Wait until no other writer renames in the folder."""
    if sys.platform == "win32":
        yield
        return
    import fcntl

    descriptor = os.open(folder, os.O_RDONLY)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)
        yield
    finally:
        os.close(descriptor)
