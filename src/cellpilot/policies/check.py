"""Whether the tensors of a policy file are those that its grid and architecture imply, before one flies with them."""

from collections.abc import Mapping
from typing import Any, get_args

import numpy as np

from cellpilot.airspace import MOVE_SETS, Rule
from cellpilot.errors import InputError
from cellpilot.policies import pair_value, tables
from cellpilot.policies.pair_value import Sides
from cellpilot.task import Task

MOST_POLICY_CELLS = 10_000_000
Shape = tuple[int | str, ...]
"""Sides of an array; a text is a size that only has to be the same wherever it stands."""


def check_sides(sides: Any) -> Sides:
    """The sides of a grid; `ValueError` unless they are three whole numbers from 1 whose product a map can have."""
    whole = isinstance(sides, list | tuple) and len(sides) == 3 and all(type(side) is int and side >= 1 for side in sides)
    if not whole or sides[0] * sides[1] * sides[2] > MOST_POLICY_CELLS:
        raise ValueError(f"sides are {sides!r:.60}; expected three whole numbers with a product up to {MOST_POLICY_CELLS:,}")
    return sides[0], sides[1], sides[2]


def check_task(about: Mapping[str, Any]) -> None:
    """`ValueError` unless the description has a task that values can be computed with."""
    task = about["task"]
    if not all(isinstance(value, int | float) and np.isfinite(value) for value in task.values()):
        raise ValueError(f"task is {task!r:.80}; expected finite numbers")
    if unknown := task.keys() - Task().as_dict().keys():
        raise ValueError(f"task has {sorted(unknown)[0]!r:.40}, which is no number of a task")
    Task(**task)


def check_look_ahead(about: Mapping[str, Any], sides: Sides) -> None:
    """`ValueError` unless the description has a look-ahead that the grid allows."""
    look_ahead = about["look_ahead"]
    most = 10 * sum(sides)
    if type(look_ahead) is not int or not 1 <= look_ahead <= most:
        raise ValueError(f"look_ahead is {look_ahead!r:.40}; expected a whole number from 1 to {most}")


def check_moves(about: Mapping[str, Any]) -> None:
    """`ValueError` unless the description names moves and a rule for forbidden ones that there are, or none."""
    if (n_moves := about.get("n_moves", 4)) not in MOVE_SETS:
        raise ValueError(f"n_moves is {n_moves!r:.40}; expected one of {', '.join(map(str, MOVE_SETS))}")
    if (rule := about.get("rule", "stay")) not in get_args(Rule):
        raise ValueError(f"rule is {rule!r:.40}; expected one of {', '.join(get_args(Rule))}")


def check_tensors(tensors: Mapping[str, np.ndarray], architecture: str, sides: Sides, about: Mapping[str, Any]) -> None:
    """`InputError` naming the first tensor that is missing, not needed, of another type or shape, or not finite."""
    n_cells, n_actions = sides[0] * sides[1] * sides[2], about.get("n_moves", 6 if sides[2] > 1 else 4)
    if architecture == pair_value.ARCHITECTURE:
        expected = _pair_shapes(tensors, sides)
    elif architecture in tables.TABLE_TENSORS:
        expected = tables.table_shapes(architecture, n_cells, n_actions)
    else:
        expected = _layers({name: t for name, t in tensors.items() if name != "blocked"}, architecture, sides, n_actions)
    if "rule" in about:
        expected |= {"blocked": (n_cells,)}
    for name in expected.keys() - tensors.keys():
        raise InputError(f"the tensor {name} is missing")
    sizes: dict[str, int] = {}
    for name, tensor in tensors.items():
        if name not in expected:
            raise InputError(f"the tensor {name} has no place in a policy of this kind")
        if not _fits(tensor.shape, expected[name], sizes):
            shape = " x ".join(str(sizes.get(side, side)) if isinstance(side, str) else str(side) for side in expected[name])
            raise InputError(f"the tensor {name} has shape {list(tensor.shape)}; expected {shape}")
        wanted = np.bool_ if name == "blocked" else np.float32
        if tensor.dtype != wanted:
            raise InputError(f"the tensor {name} is of type {tensor.dtype}; expected {np.dtype(wanted).name}")
        if name != "blocked" and not np.isfinite(tensor).all():
            raise InputError(f"the tensor {name} has values that are NaN or infinite")


def _fits(found: tuple[int, ...], expected: Shape, sizes: dict[str, int]) -> bool:
    """Whether the shape is the expected one; sizes with a name are fixed by the first tensor that has them."""
    if len(found) != len(expected):
        return False
    named = [(side, size) for side, size in zip(expected, found, strict=True) if isinstance(side, str)]
    plain = all(side == size for side, size in zip(expected, found, strict=True) if not isinstance(side, str))
    return plain and all(size >= 1 and sizes.setdefault(side, size) == size for side, size in named)


def _pair_shapes(tensors: Mapping[str, np.ndarray], sides: Sides) -> dict[str, Shape]:
    n_cells = sides[0] * sides[1] * sides[2]
    shapes: dict[str, Shape] = {
        "table": ("networks", pair_value.n_rows(sides), "hidden"),
        "weight": ("networks", "hidden", "hidden"),
        "bias": ("networks", "hidden"),
        "output": ("networks", "hidden"),
        "blocked": (n_cells,),
    }
    return shapes | ({"penalty": (n_cells,)} if "penalty" in tensors else {})


def _layers(tensors: Mapping[str, np.ndarray], architecture: str, sides: Sides, n_actions: int) -> dict[str, Shape]:
    """Names and shapes of the perceptrons of an architecture, as deep as the file has them."""
    n_dimensions = 3 if sides[2] > 1 else 2
    if architecture == "two-stream":
        width = tensors[f"psi.layers.{_depth(tensors, 'psi') - 1}.bias"].size
        parts: dict[str, tuple[int | str, int | str]] = {
            "phi": (n_dimensions, n_actions * width),
            "psi": (n_dimensions, width),
        }
    elif architecture == "dueling":
        half = tensors["value.layers.0.weight"].shape[-1] if tensors["value.layers.0.weight"].ndim else 0
        parts = {"trunk": (2 * n_dimensions, 2 * half), "value": (half, 1), "advantage": (half, n_actions)}
    else:
        parts = {"network": (2 * n_dimensions, n_actions)}
    shapes: dict[str, Shape] = {}
    for part, (first, last) in parts.items():
        depth = _depth(tensors, part)
        widths: list[int | str] = [first, *(f"{part} {i}" for i in range(1, depth)), last]
        for i in range(depth):
            shapes |= {f"{part}.layers.{i}.weight": (widths[i + 1], widths[i]), f"{part}.layers.{i}.bias": (widths[i + 1],)}
    return shapes


def _depth(tensors: Mapping[str, np.ndarray], part: str) -> int:
    """How many layers a part has, without gaps from the first."""
    depth = 1
    while f"{part}.layers.{depth}.weight" in tensors or f"{part}.layers.{depth}.bias" in tensors:
        depth += 1
    return depth
