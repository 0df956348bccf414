"""One name, one thing: no two modules of the package define the same public name."""

import ast
from collections import defaultdict
from pathlib import Path

import cellpilot

SOURCE = Path(cellpilot.__file__).parent
SHARED = {
    "main": "the entry of each command",
    "read": "what every file format offers",
    "write": "what every file format offers",
    "has_checksum": "what every file format offers, and `maps.files` for all of them",
}
LEARNERS = ("learn/algorithms/ddqn_her.py", "learn/algorithms/ddqn_her_variants.py", "learn/algorithms/fqi_her.py")
EPISODES = "learn/algorithms/ddqn_episode.py"
"""Algorithms are read side by side: the same duty has the same name in each of them."""


def public_names(path: Path) -> list[str]:
    """Functions, classes and constants that a module defines."""
    names: list[str] = []
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if isinstance(node, ast.FunctionDef | ast.ClassDef):
            names.append(node.name)
        elif isinstance(node, ast.Assign):
            names += [target.id for target in node.targets if isinstance(target, ast.Name)]
        elif isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            names.append(node.target.id)
    return [name for name in names if not name.startswith("_")]


def test_no_public_name_is_defined_twice() -> None:
    where = defaultdict(list)
    for path in sorted(SOURCE.rglob("*.py")):
        for name in public_names(path):
            where[name].append(path.relative_to(SOURCE).as_posix())
    twice = {name: files for name, files in where.items() if len(files) > 1 and name not in SHARED}
    assert {name: files for name, files in twice.items() if not set(files) <= {*LEARNERS, EPISODES}} == {}
    assert set(SHARED) <= where.keys()
    assert "Task" in where  # the names are found at all
