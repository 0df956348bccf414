"""A default of a setting is written down in one place; everybody else takes it from there."""

import ast
from collections import defaultdict
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

from cellpilot.evaluate.mobility import HandoverRule
from cellpilot.scenario import Scenario, Settings
from cellpilot.task import Task

PACKAGE = Path(__file__).parents[2] / "src" / "cellpilot"

BEING_REBUILT = ("learn/", "scenario/learner.py")  # learn/ is being rebuilt

OTHER_THINGS = {
    "bin_m": ("maps/settings.py",),  # cells of a simulation and of a log differ in size
    "power_dbm": ("maps/sources/sionna_file.py", "maps/sources/opencellid.py"),  # of other networks than the thesis's
    "carrier_hz": ("maps/sources/sionna_file.py", "maps/sources/opencellid.py"),
    "electrical_tilt_deg": ("radio/antenna_pattern.py",),  # added to what the measured cuts have
    "noise_std_db": ("maps/estimate/gaussian_process.py",),  # of a kernel
    "look_ahead": ("policies/pair_value.py",),  # of a file that does not say; learn/ is being rebuilt
    "flights": ("cli/adapt.py",),  # of the study
    "kind": ("scenario/maps.py",),  # tells the sections apart
    "name": ("policies/",),  # of a policy
    "seeds": ("cli/",),  # of a training, an ablation, a transfer study
    "what": ("maps/limits.py", "radio/propagation.py"),  # a word of a message
    "seed": ("",),  # every command has its own
}
"""Fields of one name that are other things, and where."""


def stated(tree: ast.Module) -> Iterator[tuple[str, Any, int]]:
    """Name, literal default and line of all parameters and fields; what is taken from elsewhere is no literal."""
    for node in ast.walk(tree):
        pairs: list[tuple[str, ast.expr | None]] = []
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda):
            given = node.args
            positional = [*given.posonlyargs, *given.args]
            with_default = positional[len(positional) - len(given.defaults) :]
            pairs += [(a.arg, d) for a, d in zip(with_default, given.defaults, strict=True)]
            pairs += [(a.arg, d) for a, d in zip(given.kwonlyargs, given.kw_defaults, strict=True)]
        elif isinstance(node, ast.ClassDef):
            fields = [s for s in node.body if isinstance(s, ast.AnnAssign) and isinstance(s.target, ast.Name)]
            pairs += [(ast.unparse(s.target), s.value) for s in fields]
        for name, value in pairs:
            if isinstance(value, ast.Call) and ast.unparse(value.func) == "Field" and value.args:
                value = value.args[0]
            try:
                default = ast.literal_eval(value) if value is not None else None
            except ValueError:
                continue
            if default is not None and not isinstance(default, bool) and default not in ("", ()):
                yield name, default, node.lineno


def places(sources: dict[str, str]) -> dict[str, list[str]]:
    """Where each name has a literal default, without what is allowed."""
    found: dict[str, list[str]] = defaultdict(list)
    for path, text in sources.items():
        for name, default, line in stated(ast.parse(text)):
            if not path.startswith((*BEING_REBUILT, *OTHER_THINGS.get(name, ("\0",)))):
                found[name].append(f"{path}:{line} {name} = {default!r}")
    return found


def models(kind: type[Settings] = Settings) -> Iterator[type[Settings]]:
    """All settings models that are loaded."""
    for model in kind.__subclasses__():
        yield model
        yield from models(model)


def names() -> set[str]:
    """Every field of a settings model, of the command line too, and of the task."""
    for path in (PACKAGE / "cli").rglob("*.py"):
        import_module(".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__"))
    found = {name for model in models() for name in model.model_fields}
    assert {"rings", "threshold_db", "speed_mps", "max_age_s", "points_per_side"} <= found
    return found | set(Task().as_dict())


SOURCES = {path.relative_to(PACKAGE).as_posix(): path.read_text() for path in sorted(PACKAGE.rglob("*.py"))}


def test_every_default_of_a_setting_is_stated_once() -> None:
    found = places(SOURCES)
    again = [place for name in sorted(names()) if len(found[name]) > 1 for place in found[name]]
    assert not again, "\n".join(again)


def test_a_default_stated_again_is_found() -> None:
    again = "def hexagonal(rings: int = 1, *, load: float = 1.0): ...\nclass Rule:\n    speed_mps: float = 10.0\n"
    found = places(SOURCES | {"again.py": again})
    assert [len(found[name]) for name in ("rings", "load", "speed_mps")] == [2, 2, 2]


def test_the_scenario_takes_rewards_and_handovers_from_their_owners() -> None:
    scenario = Scenario()
    of_task = {name: value for name, value in Task().as_dict().items() if name != "max_steps"}
    assert scenario.task.model_dump(include=set(of_task)) == of_task
    assert isinstance(scenario.evaluation, HandoverRule)
