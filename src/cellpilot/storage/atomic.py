"""Writing a file so that a half-written one never stays, whoever else writes at the same time."""

import os
import secrets
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from cellpilot.errors import WriteError

TEMPORARY = ".partial-"
"""How the name of a file begins while it is being written."""
NO_FOLLOW = getattr(os, "O_NOFOLLOW", 0)


def write_atomically(path: Path, content: bytes | str) -> None:
    """Write the content (text as UTF-8) to a file of our own beside `path`, flush it to disk and rename it into place.

    The folder is made if missing; permissions are those of the umask. `WriteError` names the file and says why it could not
    be written; `path` then stays as it was and nothing else stays. What a kill left behind goes with the next write to
    the same name.
    """
    with complaints(path):
        data = content if isinstance(content, bytes) else content.encode()
        path.parent.mkdir(parents=True, exist_ok=True)
        remove_leftovers(path)
        descriptor, temporary = _create_beside(path)
        try:
            with os.fdopen(descriptor, "wb") as file:
                file.write(data)
                file.flush()
                os.fsync(file.fileno())
                temporary.replace(path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise


def remove_leftovers(path: Path) -> None:
    """Delete the temporary files of `path` that no living writer holds."""
    for entry in path.parent.iterdir():
        if not entry.name.startswith(TEMPORARY) or not entry.name.endswith(f"-{path.name}") or not entry.is_file():
            continue
        try:
            descriptor = os.open(entry, os.O_RDWR | NO_FOLLOW)
        except OSError:
            continue  # a link, or somebody else's
        try:
            if lock(descriptor):
                entry.unlink(missing_ok=True)
        finally:
            os.close(descriptor)


def lock(descriptor: int) -> bool:
    """Take the lock of an open file, which the system gives back when the process ends; False if another one has it."""
    if sys.platform == "win32":
        return True
    import fcntl

    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return True  # a file system without locks
    return True


def _create_beside(path: Path) -> tuple[int, Path]:
    """A new, locked file of a name that nobody else has."""
    while True:
        temporary = path.with_name(f"{TEMPORARY}{secrets.token_hex(4)}-{path.name}")
        try:
            descriptor = os.open(temporary, os.O_RDWR | os.O_CREAT | os.O_EXCL | NO_FOLLOW, 0o666)
        except FileExistsError:
            continue
        # Between these two lines another writer may have taken it for a leftover.
        if lock(descriptor) and temporary.exists():
            return descriptor, temporary
        os.close(descriptor)


@contextmanager
def complaints(path: Path) -> Iterator[None]:
    """Everything that keeps a file from being written as one kind of error that names it."""
    try:
        yield
    except OSError as error:
        reason = (error.strerror or str(error)).lower()
        raise WriteError(f"{path}: cannot be written ({reason}); make room there, or choose another folder or name") from None
    except UnicodeEncodeError as error:
        found = error.object[error.start : error.end]
        raise WriteError(f"{path}: cannot be written, {found!r} is no Unicode text: rename what it stands for") from None
    except ValueError as error:
        raise WriteError(f"{str(path)!r}: cannot be written ({error}); choose another name") from None
