"""Turning arguments into settings: scenario file first, every setting as a flag on top of it."""

import contextlib
import io
import re
import shlex
import sys
from collections.abc import Iterable, Sequence
from difflib import get_close_matches
from functools import partial
from pathlib import Path
from typing import TypeVar, get_args

import tyro
from pydantic import BaseModel, Field, ValidationError

from cellpilot.errors import InputError
from cellpilot.scenario import (
    LEARNERS,
    PUBLISHED_LEARNER,
    SHIPPED,
    AirspaceSettings,
    AnyLearner,
    MapFile,
    MapSettings,
    Scenario,
    Settings,
    SimulatedMap,
    TaskSettings,
    describe,
    find_scenario,
    load_scenario,
    one_name,
)
from cellpilot.storage import resolved

Options = TypeVar("Options", bound=BaseModel)
HELP = ("-h", "--help")
THESIS = "thesis-2d"
"""The scenario where none is named."""


class ScenarioOptions(Settings):
    """What every command on a scenario takes: the scenario, and every setting as a flag."""

    scenario: tyro.conf.Positional[str] = Field(THESIS, description="TOML file or name of a shipped scenario")
    map: MapSettings = SimulatedMap()
    task: TaskSettings = TaskSettings()
    airspace: AirspaceSettings = AirspaceSettings()
    learner: AnyLearner = PUBLISHED_LEARNER


InScenario = TypeVar("InScenario", bound=ScenarioOptions)


def parse_scenario(kind: type[InScenario], arguments: Sequence[str], verb: str, description: str) -> tuple[InScenario, Scenario]:
    """Options of a command on a scenario, and the scenario with the flags applied; `--map FILE` takes the place of its map."""
    arguments, map_file = _asked_map(arguments)
    found = scenario_argument(arguments)
    name, scenario = found if found else ("thesis-2d", Scenario(name="thesis-2d"))
    if map_file is not None:
        scenario = scenario.model_copy(update={"map": MapFile(path=map_file), "name": _name_on(scenario.name, map_file)})
    if (algorithm := _asked_algorithm(arguments)) not in (None, scenario.learner.algorithm):
        scenario = scenario.model_copy(update={"learner": LEARNERS[algorithm].model_validate({})})
    _refuse_other_learner(arguments, scenario)
    sections = [section for section in ("map", "task", "airspace", "learner", "evaluation") if section in kind.model_fields]
    default = kind(scenario=name, **{section: getattr(scenario, section) for section in sections})
    options = parse(kind, arguments, f"cellpilot {verb}", f"{description} --map FILE: on that map.", default)
    return options, scenario.model_copy(update={section: getattr(options, section) for section in sections})


def _name_on(scenario: str, map_file: Path) -> str:
    """The name of a scenario on another map; without that of the map where no folder can be called so."""
    try:
        return one_name(f"{scenario}-on-{map_file.stem}")
    except ValueError:
        return f"{scenario}-on-another-map"


def _asked_map(arguments: Sequence[str]) -> tuple[list[str], Path | None]:
    """The arguments without `--map FILE`, and the file; None if not given."""
    rest, files = [], []
    pending = iter(arguments)
    for argument in pending:
        flag, _, joined = argument.partition("=")
        if flag == "--map":
            files.append(joined or next(pending, ""))
        else:
            rest.append(argument)
    if len(files) > 1 or any(not file or file.startswith("-") for file in files):
        raise InputError(f"--map {' --map '.join(files)}: expected one map file")
    return rest, Path(files[0]) if files else None


def _asked_algorithm(arguments: Sequence[str]) -> str | None:
    """The value of `--learner.algorithm`, which decides what other flags of the learner there are; None if not given."""
    for flag, value in zip(arguments, [*arguments[1:], ""], strict=True):
        name, _, joined = flag.partition("=")
        if name == "--learner.algorithm":
            found = joined or value
            if found not in LEARNERS:
                raise InputError(f"--learner.algorithm is {found!r}; expected one of {', '.join(LEARNERS)}")
            return found
    return None


def _refuse_other_learner(arguments: Sequence[str], scenario: Scenario) -> None:
    """`InputError` for a flag that only another algorithm than the scenario's has."""
    own = scenario.learner.algorithm
    for flag in (argument.partition("=")[0] for argument in arguments if argument.startswith("--learner.")):
        name = flag.removeprefix("--learner.").removeprefix("no-").replace("-", "_")
        having = [algorithm for algorithm, settings in LEARNERS.items() if name in settings.model_fields]
        if having and own not in having:
            raise InputError(f"{flag} is a setting of {having[0]}, but {scenario.name} trains {own}: see its own with --help")


def parse(kind: type[Options], arguments: Sequence[str], prog: str, description: str, default: Options | None = None) -> Options:
    """Options from arguments; `InputError` in one line instead of a box, help and exit 0 for `--help`."""
    call = partial(
        tyro.cli,
        kind,
        prog=prog,
        description=description,
        config=(tyro.conf.AvoidSubcommands, tyro.conf.FlagCreatePairsOff),
        **({} if default is None else {"default": default}),
    )
    if any(argument in HELP for argument in arguments):
        return call(args=["--help"])
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box), contextlib.redirect_stdout(box):
            return call(args=list(arguments))
    except ValidationError as error:
        raise InputError(describe(error, "command line")) from error
    except SystemExit as error:
        if not error.code:
            raise
        raise InputError(_message(box.getvalue(), prog) + _nearest(box.getvalue(), kind)) from error


def _nearest(box: str, kind: type[BaseModel]) -> str:
    """The option that a mistyped one may have been meant for."""
    unknown = re.search(r"Unrecognized options: (--[\w.-]+)", " ".join(box.split()))
    near = get_close_matches(unknown[1].replace("_", "-"), flags_of(kind), 1) if unknown else []
    return f"; perhaps you meant {near[0]}" if near else ""


def flags_of(kind: type[BaseModel], prefix: str = "--") -> list[str]:
    """All options of a command, those of its sections too."""
    flags = []
    for name, field in kind.model_fields.items():
        renamed = [item.name for item in field.metadata if getattr(item, "name", None)]
        flag = f"{prefix}{(renamed or [name])[0].replace('_', '-')}"
        sections = [part for part in (field.annotation, *get_args(field.annotation)) if isinstance(part, type)]
        models = [part for part in sections if issubclass(part, BaseModel)]
        flags += [flag] if not models else [each for model in models for each in flags_of(model, f"{flag}.")]
    return list(dict.fromkeys(flags))


def _message(box: str, prog: str) -> str:
    """What tyro says, without its frame, title and suggestions. Written to a buffer, it draws with ASCII dashes."""
    blocks = re.split(r"\n *-{5,} *\n", box)
    message = " ".join(blocks[min(1, len(blocks) - 1)].split())
    message = re.sub(r"invalid literal for int\(\) with base 10: ('.*?')", r"expected a whole number, found \1", message)
    message = re.sub(r"could not convert string to float: ('.*?')", r"expected a number, found \1", message)
    if no_match := re.search(r"Error parsing (--\S+): no type matching (.*?) could be instantiated from (\[.*?\])\.", message):
        flag, expected, found = no_match.groups()
        return f"{flag} {found}: expected {expected.replace('[bold]', '').replace('[/bold]', '')}"
    if inconsistent := re.search(r"Value error, (.*?) \[type=value_error", message):
        return inconsistent[1]
    invalid = re.search(
        r"Error parsing (\S+?):? 1 validation error for \w+ (\S+) (.*?) \[type=\w+, input_value=(.*?), input_type", message
    )
    if invalid:
        section, field, what, value = invalid.groups()
        section = "" if section.endswith("Options") or section.startswith("{") else f"{section.removeprefix('--')}."
        return f"--{(section + field).replace('_', '-')} {value}: {what.replace('Input should', 'should')}"
    return f"{message or 'the arguments could not be read'} (see {prog} --help)"


def scenario_argument(arguments: Sequence[str]) -> tuple[str, Scenario] | None:
    """The scenario among the arguments, as written and loaded; None if `--help` comes without one.

    It is the first argument that names a file or a shipped scenario; flags and their values are skipped.
    """
    pairs = zip(["", *arguments], arguments, strict=False)
    plain = [argument for before, argument in pairs if not argument.startswith("-") and before != "--out"]
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
    return shlex.join([Path(sys.argv[0]).name, *sys.argv[1:]])


def refuse_idle(options: Settings, names: Sequence[str], why: str, section: str = "") -> None:
    """`InputError` if one of the named options of a section (`map.`) was given, although it would do nothing."""
    for name in names:
        if getattr(options, name) != type(options).model_fields[name].default:
            raise InputError(f"--{section}{name.replace('_', '-')} {why}: leave it out")


def refuse_overwriting(out: Path, inputs: Iterable[Path | None], flag: str = "--out") -> None:
    """`InputError` if the output is one of the files that are read."""
    for path in inputs:
        if path is not None and resolved(path) == resolved(out):
            raise InputError(f"{out}: is read and would be overwritten; choose another file with {flag}")
