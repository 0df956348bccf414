"""Policy files: what does not belong to grid and architecture is refused in one line, whatever it is."""

import json
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.policies import PolicyParameters, load_parameters, pair_value
from cellpilot.policies.learned import POLICY_FORMAT, save_parameters
from cellpilot.scenario import SHIPPED
from cellpilot.task import Task

Tensors = dict[str, np.ndarray]
GRIDS = {2: (4, 3, 1), 3: (4, 3, 2)}
ABOUT = {"task": Task().as_dict(), "look_ahead": 3}


def perceptron(rng: np.random.Generator, part: str, *widths: int) -> Tensors:
    found: Tensors = {}
    for i, (n_in, n_out) in enumerate(pairwise(widths)):
        found[f"{part}.layers.{i}.weight"] = rng.normal(size=(n_out, n_in)).astype(np.float32)
        found[f"{part}.layers.{i}.bias"] = rng.normal(size=n_out).astype(np.float32)
    return found


def tensors_of(architecture: str, dims: int) -> Tensors:
    """Random weights of an architecture on the grid of that many dimensions."""
    rng, sides = np.random.default_rng(0), GRIDS[dims]
    n_cells = int(np.prod(sides))
    if architecture == "concatenated":
        return perceptron(rng, "network", 2 * dims, 7, 5, 2 * dims)
    if architecture == "two-stream":
        return perceptron(rng, "phi", dims, 7, 2 * dims * 5) | perceptron(rng, "psi", dims, 6, 5)
    if architecture == "dueling":
        parts = [("trunk", 2 * dims, 7, 8), ("value", 4, 1), ("advantage", 4, 2 * dims)]
        return {name: tensor for part, *widths in parts for name, tensor in perceptron(rng, part, *widths).items()}
    shapes = {"table": (2, pair_value.n_rows(sides), 6), "weight": (2, 6, 6), "bias": (2, 6), "output": (2, 6)}
    pair = {name: rng.normal(size=shape).astype(np.float32) for name, shape in shapes.items()}
    return pair | {"penalty": rng.random(n_cells).astype(np.float32), "blocked": np.zeros(n_cells, bool)}


ARCHITECTURES = ("concatenated", "two-stream", "dueling", pair_value.ARCHITECTURE)


@pytest.mark.parametrize("dims", [2, 3])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_right_policy_is_read_and_flies(tmp_path: Path, architecture: str, dims: int) -> None:
    save_parameters(PolicyParameters(tensors_of(architecture, dims), architecture, GRIDS[dims], ABOUT), tmp_path / "p")
    parameters = load_parameters(tmp_path / "p")
    assert parameters.checked
    grid = Grid(*(tuple(20.0 * i for i in range(side)) for side in GRIDS[dims]))
    assert np.isfinite(parameters.values(grid, np.arange(grid.n_cells))).all()


def write(path: Path, tensors: Tensors, header: Any) -> None:
    """A file without a checksum, as somebody else writes it."""
    save_file(tensors, path, metadata={POLICY_FORMAT: header if isinstance(header, str) else json.dumps(header)})


def first(tensors: Tensors) -> str:
    return next(name for name in sorted(tensors) if name.endswith("weight"))


def with_value(value: float) -> Callable[[np.ndarray], np.ndarray]:
    def change(tensor: np.ndarray) -> np.ndarray:
        changed = tensor.copy()
        changed.flat[0] = value
        return changed

    return change


CHANGES: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "NaN": with_value(np.nan),
    "infinite": with_value(np.inf),
    "float64": lambda t: t.astype(np.float64),
    "float16": lambda t: t.astype(np.float16),
    "int32": lambda t: t.astype(np.int32),
    "bool": lambda t: t.astype(bool),
    "one row less": lambda t: t[:-1].copy(),
    "one column more": lambda t: np.concatenate([t, t[..., :1]], axis=-1),
    "empty": lambda t: t[:0].copy(),
    "another dimension": lambda t: t[None].copy(),
    "a number": lambda t: np.array(1.0, np.float32),
}


@pytest.mark.parametrize("change", CHANGES)
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_wrong_tensor_is_named(tmp_path: Path, architecture: str, change: str) -> None:
    for name in tensors_of(architecture, 2):
        tensors = tensors_of(architecture, 2)
        if name == "blocked" and change in ("NaN", "infinite", "bool"):
            continue
        tensors[name] = CHANGES[change](tensors[name])
        write(tmp_path / "p", tensors, {"architecture": architecture, "sides": GRIDS[2], "about": ABOUT})
        with pytest.raises(InputError, match=r"p: .*tensor.*; train again or restore it$"):
            load_parameters(tmp_path / "p")


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_missing_or_further_tensor_is_named(tmp_path: Path, architecture: str) -> None:
    header = {"architecture": architecture, "sides": GRIDS[2], "about": ABOUT}
    for name in tensors_of(architecture, 2).keys() - {"penalty"}:
        tensors = tensors_of(architecture, 2)
        del tensors[name]
        write(tmp_path / "p", tensors, header)
        with pytest.raises(InputError, match="tensor"):
            load_parameters(tmp_path / "p")
    write(tmp_path / "p", tensors_of(architecture, 2) | {"more": np.zeros(1, np.float32)}, header)
    with pytest.raises(InputError, match="more has no place"):
        load_parameters(tmp_path / "p")


def test_transposed_square_weights_are_noticed_by_the_checksum(tmp_path: Path) -> None:
    tensors = tensors_of(pair_value.ARCHITECTURE, 2)
    save_parameters(PolicyParameters(tensors, pair_value.ARCHITECTURE, GRIDS[2], ABOUT), tmp_path / "p")
    from safetensors import safe_open

    with safe_open(tmp_path / "p", framework="np") as file:
        metadata = file.metadata()
    changed = load_file(tmp_path / "p") | {"weight": tensors["weight"].transpose(0, 2, 1).copy()}
    save_file(changed, tmp_path / "p", metadata=metadata)
    with pytest.raises(InputError, match="checksum mismatch"):
        load_parameters(tmp_path / "p")


HEADERS: list[Any] = [
    {"sides": [4, 3]},
    {"sides": [4, 3, 0]},
    {"sides": [4.0, 3, 1]},
    {"sides": [float("inf"), 1, 1]},
    {"sides": [True, 3, 1]},
    {"sides": "431"},
    {"sides": [10**6, 10**6, 1]},
    {"sides": None},
    {"architecture": "other"},
    {"architecture": None},
    {"architecture": ["concatenated"]},
    {"about": None},
    {"about": [1]},
    {"about": {}},
    {"about": ABOUT | {"task": None}},
    {"about": ABOUT | {"task": {"rho_goal": "x"}}},
    {"about": ABOUT | {"task": Task().as_dict() | {"discount": float("nan")}}},
    {"about": ABOUT | {"task": Task().as_dict() | {"more": 1}}},
    *({"about": ABOUT | {"look_ahead": value}} for value in (10**9, 0, -1, "3", 1.5, float("inf"), None, True, [3])),
    {"more": 1},
    "{",
    "[]",
    "[" * 100_000,
    "null",
]


@pytest.mark.parametrize("change", HEADERS)
def test_a_wrong_header_is_one_line(tmp_path: Path, change: Any) -> None:
    right = {"architecture": pair_value.ARCHITECTURE, "sides": list(GRIDS[2]), "about": ABOUT}
    write(tmp_path / "p", tensors_of(pair_value.ARCHITECTURE, 2), right | change if isinstance(change, dict) else change)
    with pytest.raises(InputError) as error:
        load_parameters(tmp_path / "p")
    assert "\n" not in str(error.value)
    assert str(tmp_path / "p") in str(error.value)


def test_shipped_policies_carry_a_checksum() -> None:
    found = [load_parameters(path) for path in SHIPPED.glob("*.safetensors")]
    assert len(found) == 3
    assert all(parameters.checked for parameters in found)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_values_computed_for_some_goals_at_a_time_are_the_same(architecture: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from cellpilot.policies import learned

    parameters = PolicyParameters(tensors_of(architecture, 2), architecture, GRIDS[2], ABOUT)
    grid = Grid(*(tuple(20.0 * i for i in range(side)) for side in GRIDS[2]))
    whole = parameters.values(grid, np.arange(grid.n_cells))
    monkeypatch.setattr(learned, "MOST_VALUES", 100)
    monkeypatch.setattr(pair_value, "MOST_PAIRS_VALUED", 12)
    np.testing.assert_allclose(parameters.values(grid, np.arange(grid.n_cells)), whole, rtol=1e-5, atol=1e-6)
