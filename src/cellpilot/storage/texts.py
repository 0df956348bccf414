"""Text and JSON files: UTF-8 everywhere, and one line about what is wrong with one."""

import json
from pathlib import Path
from typing import Any

from cellpilot.errors import InputError
from cellpilot.storage.atomic import write_atomically

LARGEST_BYTES = 64_000_000
"""Of a text that is read as a whole."""


def read_text(path: Path, remedy: str) -> str:
    """The text of a UTF-8 file, with or without a byte-order mark; `InputError` if it cannot be read."""
    try:
        if (size := path.stat().st_size) > LARGEST_BYTES:
            raise InputError(f"{path}: {size / 1e6:.0f} MB; at most {LARGEST_BYTES / 1e6:.0f} MB of text are read; {remedy}")
        return path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: not UTF-8 text (byte {error.start}: {error.reason}); {remedy}") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({(error.strerror or str(error)).lower()}); {remedy}") from None


def parse_json(text: str, where: str, remedy: str) -> dict[str, Any]:
    """The JSON object in a text; `InputError` names `where` it stands and ends with `remedy`."""
    try:
        found = json.loads(text)
    except RecursionError:
        raise InputError(f"{where}: brackets nested too deeply; {remedy}") from None
    except ValueError as error:
        raise InputError(f"{where}: not readable as JSON ({str(error)[:120]}); {remedy}") from None
    if not isinstance(found, dict):
        raise InputError(f"{where}: holds a {type(found).__name__}; expected a JSON object; {remedy}")
    return found


def read_json(path: Path, remedy: str) -> dict[str, Any]:
    """The JSON object in a file; `InputError` as `parse_json` gives it."""
    return parse_json(read_text(path, remedy), str(path), remedy)


def write_json(path: Path, content: Any) -> None:
    """Write JSON atomically."""
    write_atomically(path, json.dumps(content, indent=2) + "\n")


def resolved(path: Path) -> Path:
    """The path without links; `InputError` for links that lead in a circle or a name that no file can have."""
    try:
        return path.resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise InputError(f"{str(path)!r}: cannot be followed ({' '.join(str(error).split())}); choose another place") from None
