"""The whole scenario, and the TOML files it is read from and written to."""

import json
import re
import tomllib
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field, ValidationError

from cellpilot.errors import InputError
from cellpilot.scenario.learner import LEARNERS, PUBLISHED_LEARNER, AnyLearner
from cellpilot.scenario.maps import MapSettings, SimulatedMap
from cellpilot.scenario.task import AirspaceSettings, EvaluationSettings, TaskSettings
from cellpilot.settings import Settings
from cellpilot.storage import read_text


def one_name(name: str) -> str:
    """`ValueError` for a name that would lead files elsewhere, or that no file can have."""
    if not name or name.startswith((".", "-")) or len(name.encode("utf-8", "replace")) > LONGEST_NAME:
        raise ValueError(f"name is {name[:40]!r}; expected 1 to {LONGEST_NAME} bytes that do not begin with a dot or a dash")
    if not name.isprintable() or any(letter in '/\\:*?"<>|' for letter in name) or name != name.strip():
        raise ValueError(f"name is {name[:40]!r}; expected one name of a file: letters, digits, spaces within, - _ . + , ( )")
    return name


LONGEST_NAME = 100
Name = Annotated[str, AfterValidator(one_name)]
"""Of a scenario: it becomes the name of a folder."""


class Scenario(Settings):
    """One experiment."""

    name: Name = Field("scenario", description="name in tables and files")
    map: MapSettings = Field(SimulatedMap(), discriminator="kind")
    task: TaskSettings = TaskSettings()
    airspace: AirspaceSettings = AirspaceSettings()
    learner: AnyLearner = Field(PUBLISHED_LEARNER, discriminator="algorithm")
    evaluation: EvaluationSettings = EvaluationSettings()


SHIPPED = Path(__file__).parents[1] / "scenarios"


def find_scenario(name: str) -> Path:
    """The file of that path, or the shipped scenario of that name; `InputError` if there is neither."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = sorted(p.stem for p in SHIPPED.glob("*.toml"))
    if name in shipped:
        return SHIPPED / f"{name}.toml"
    near = get_close_matches(name, shipped, 1)
    hint = f"; perhaps you meant {near[0]}" if near else ""
    raise InputError(f"{name}: no such scenario file; expected a TOML file or one of {', '.join(shipped)}{hint}")


def load_scenario(path: Path) -> Scenario:
    """Read a scenario; `InputError` names the file, the line and the field of what is wrong.

    Relative paths in it are relative to the working directory, as on the command line.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such scenario file")
    text = read_text(path, "expected a scenario in TOML")
    try:
        data = tomllib.loads(text)
    except RecursionError:
        raise InputError(f"{path}: not valid TOML: brackets nested too deeply") from None
    except ValueError as error:
        raise InputError(f"{path}: not valid TOML: {' '.join(str(error).split())[:160]}") from None
    if not data:
        raise InputError(f"{path}: the file is empty; expected sections map, task, airspace, learner, evaluation")
    data.setdefault("name", path.stem)
    if isinstance(data.get("map"), dict):
        data["map"].setdefault("kind", "simulated")
    if isinstance(data.get("learner"), dict):
        data["learner"].setdefault("algorithm", "ddqn-her")
    return validated(Scenario, data, str(path), text)


def validated(model: type[Scenario], data: dict[str, Any], where: str, text: str = "") -> Scenario:
    """`model` built from data; the first problem becomes a one-line `InputError`."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(describe(error, where, text)) from error


def describe(error: ValidationError, where: str, text: str = "") -> str:
    """One line for the first problem of a pydantic error: file and line, field, what was found, what was expected."""
    first = error.errors(include_url=False)[0]
    keys = [str(key) for key in first["loc"] if str(key) not in ("simulated", "measured", "file", *LEARNERS)]
    line = _line_of(keys, text)
    place = f"{where}:{line}" if line else where
    field = ".".join(keys) or "settings"
    if first["type"] == "extra_forbidden":
        return f"{place}: unknown key {field}; see cellpilot run --help for the settings"
    message = first["msg"].removeprefix("Value error, ").replace("Input should", "should")
    found = "" if first["type"] == "value_error" else f" is {short(first['input'])}"
    return f"{place}: {field}{found}: {message[0].lower()}{message[1:]}"


def short(value: Any) -> str:
    """A value as it was written, cut where it is long."""
    text = repr(value)
    return text if len(text) <= 80 else f"{text[:77]}..."


def _line_of(keys: list[str], text: str) -> int | None:
    """Line of the field `keys`, counted from 1: its own line, that of a table it stands in, or of its section."""
    section: list[str] = []
    best, longest = None, 0
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            section = here = header[1].split(".")
        elif key := re.match(r"\s*([\w.-]+)\s*=", line):
            here = section + key[1].split(".")
        else:
            continue
        if here == keys[: len(here)] and len(here) > longest:
            best, longest = number, len(here)
    return best


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as TOML text that `load_scenario` reads back equal."""
    lines = [f"name = {_toml(scenario.name)}"]
    for section, values in scenario.model_dump(mode="json").items():
        if isinstance(values, dict):
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
