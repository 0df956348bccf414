"""Turning arguments into settings: scenario file first, every setting as a flag on top of it."""

import contextlib
import io
import re
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import tyro
from pydantic import BaseModel, ValidationError

from cellpilot.errors import InputError
from cellpilot.scenario import SHIPPED, Scenario, describe, find_scenario, load_scenario

Options = TypeVar("Options", bound=BaseModel)
HELP = ("-h", "--help")


def parse(kind: type[Options], arguments: Sequence[str], prog: str, description: str, default: Options | None = None) -> Options:
    """Options from arguments; `InputError` in one line instead of a box, help and exit 0 for `--help`."""
    config = (tyro.conf.AvoidSubcommands, tyro.conf.FlagCreatePairsOff)
    if any(argument in HELP for argument in arguments):
        return _parsed(kind, [*arguments, "--help"][-1:], prog, description, default, config)
    noise = io.StringIO()
    try:
        with contextlib.redirect_stderr(noise), contextlib.redirect_stdout(noise):
            return _parsed(kind, arguments, prog, description, default, config)
    except ValidationError as error:
        raise InputError(describe(error, "command line")) from error
    except SystemExit as error:
        if not error.code:
            raise
        raise InputError(_first_sentence(noise.getvalue(), prog)) from error


def _parsed(
    kind: type[Options],
    arguments: Sequence[str],
    prog: str,
    description: str,
    default: Options | None,
    config: tuple[object, ...],
) -> Options:
    if default is None:
        return tyro.cli(kind, args=list(arguments), prog=prog, description=description, config=config)
    return tyro.cli(kind, args=list(arguments), prog=prog, description=description, default=default, config=config)


def _first_sentence(box: str, prog: str) -> str:
    """The message inside tyro's drawn box, without its frame and the list of suggestions."""
    blocks = re.split(r"\n[ │|+]*[─-]{5,}[ │|+]*\n", re.sub("[╭╮╰╯]", " ", box))
    body = blocks[1] if len(blocks) > 1 and "─" not in blocks[0] else re.sub(r"^[^\n]*─[^\n]*\n", "", blocks[0].lstrip("\n"))
    message = " ".join(body.replace("│", " ").split())
    pydantic_error = re.search(
        r"Error parsing (\S+?):? 1 validation error for \w+ (\S+) (.*?) \[type=\w+, input_value=(.*?), input_type", message
    )
    inconsistent = re.search(r"Value error, (.*?) \[type=value_error", message)
    if inconsistent:
        return inconsistent[1]
    if pydantic_error:
        section, field, what, value = pydantic_error.groups()
        section = "" if section == "default" or section.startswith("{") else f"{section.removeprefix('--')}."
        return f"--{(section + field).replace('_', '-')} {value}: {what.replace('Input should', 'should')}"
    return f"{message or 'the arguments could not be read'} (see {prog} --help)"


def scenario_argument(arguments: Sequence[str]) -> tuple[str, Scenario] | None:
    """The scenario among the arguments, as written and loaded; None if `--help` comes without one.

    It is the first argument that names a file or a shipped scenario; flags and their values are skipped.
    """
    plain = [argument for argument in arguments if not argument.startswith("-")]
    shipped = {path.stem for path in SHIPPED.glob("*.toml")}
    for argument in plain:
        if argument in shipped or argument.endswith(".toml"):
            return argument, load_scenario(find_scenario(argument))
    if any(argument in HELP for argument in arguments):
        return None
    if not arguments or arguments[0].startswith("-"):
        raise InputError(f"a scenario is missing: give a TOML file or one of {', '.join(sorted(shipped))}")
    return arguments[0], load_scenario(find_scenario(arguments[0]))


def command_line() -> str:
    """The command as it was called, for provenance: the program by name, without the folder it lies in."""
    return " ".join([Path(sys.argv[0]).name, *sys.argv[1:]])
