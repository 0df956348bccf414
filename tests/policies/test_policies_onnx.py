"""ONNX files compute what the policy computes, by somebody else's runtime."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import onnxruntime
import pytest

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.policies import PolicyParameters, load_parameters, onnx_file, pair_value
from cellpilot.policies.base import greedy_actions
from cellpilot.policies.learned import TENSORS
from cellpilot.policies.onnx_file import BUILDERS, save_onnx
from cellpilot.scenario import SHIPPED
from cellpilot.task import Task

Sides = tuple[int, int, int]
PLAIN, HARD = Task(), Task(rho_goal=3.0, rho_sinr=-2.0, rho_step=-0.3, rho_blocked=-1.5, discount=1.0)


def perceptron(rng: np.random.Generator, name: str, sizes: tuple[int, ...]) -> dict[str, np.ndarray]:
    """Random weights and biases."""
    tensors = {}
    for i, (n_in, n_out) in enumerate(pairwise(sizes)):
        tensors[f"{name}.layers.{i}.weight"] = rng.normal(size=(n_out, n_in)).astype(np.float32)
        tensors[f"{name}.layers.{i}.bias"] = rng.normal(size=n_out).astype(np.float32)
    return tensors


def concatenated(sides: Sides, layers: tuple[int, ...] = (7, 5)) -> PolicyParameters:
    """A policy of random weights."""
    dims = 3 if sides[2] > 1 else 2
    tensors = perceptron(np.random.default_rng(0), "network", (2 * dims, *layers, 2 * dims))
    return PolicyParameters(tensors, "concatenated", sides, {"seed": 3})


def two_stream(sides: Sides) -> PolicyParameters:
    """A policy of random weights; the streams end in 6 features."""
    dims, rng = 3 if sides[2] > 1 else 2, np.random.default_rng(1)
    tensors = perceptron(rng, "phi", (dims, 7, 5, 2 * dims * 6)) | perceptron(rng, "psi", (dims, 7, 5, 6))
    return PolicyParameters(tensors, "two-stream", sides)


def dueling(sides: Sides, shared: tuple[int, ...] = (7, 5)) -> PolicyParameters:
    """A policy of random weights; the two streams are 6 wide."""
    dims, rng = 3 if sides[2] > 1 else 2, np.random.default_rng(3)
    tensors = perceptron(rng, "trunk", (2 * dims, *shared, 2 * 6))
    tensors |= perceptron(rng, "value", (6, 1)) | perceptron(rng, "advantage", (6, 2 * dims))
    return PolicyParameters(tensors, "dueling", sides)


def pair(sides: Sides, task: Task = PLAIN, look_ahead: int = 1, networks: int = 1, penalty: bool = True) -> PolicyParameters:
    """A policy of random weights, with blocked cells."""
    rng, n, units = np.random.default_rng(2), sides[0] * sides[1] * sides[2], 6
    shapes = {"table": (pair_value.n_rows(sides), units), "weight": (units, units), "bias": (units,), "output": (units,)}
    tensors = {name: rng.normal(size=(networks, *shape)).astype(np.float32) for name, shape in shapes.items()}
    tensors["blocked"] = (rng.random(n) < 0.2).astype(np.float32)
    if penalty:
        tensors["penalty"] = rng.random(n).astype(np.float32)
    return PolicyParameters(tensors, pair_value.ARCHITECTURE, sides, {"task": task.as_dict(), "look_ahead": look_ahead})


POLICIES = {
    "concatenated 2D": concatenated((4, 3, 1)),
    "concatenated 3D": concatenated((3, 4, 2)),
    "concatenated linear": concatenated((4, 3, 1), ()),
    "two-stream 2D": two_stream((4, 3, 1)),
    "two-stream 3D": two_stream((3, 4, 2)),
    "dueling 2D": dueling((4, 3, 1)),
    "dueling 3D": dueling((3, 4, 2), ()),
    "pair-value 2D": pair((4, 3, 1)),
    "pair-value 3D": pair((3, 4, 2), HARD),
    "pair-value one row": pair((5, 1, 1)),
    "pair-value model-free": pair((4, 3, 1), penalty=False),
    "pair-value of two networks": pair((3, 4, 2), networks=2),
    "pair-value looking ahead": pair((4, 3, 1), HARD, look_ahead=2),
    "pair-value looking far": pair((3, 4, 2), look_ahead=4, networks=2),
    "pair-value looking as far as the shipped scenarios": pair((3, 4, 2), HARD, look_ahead=16),
    "shipped 2D": load_parameters(SHIPPED / "thesis-2d.safetensors"),
    "shipped 3D": load_parameters(SHIPPED / "thesis-3d.safetensors"),
}


@pytest.mark.parametrize("name", POLICIES)
def test_values_and_actions_are_those_of_the_policy(tmp_path: Path, name: str) -> None:
    parameters = POLICIES[name]
    grid = Grid(*(tuple(20.0 * i for i in range(n)) for n in parameters.sides))
    save_onnx(parameters, tmp_path / "policy.onnx")
    session = onnxruntime.InferenceSession(tmp_path / "policy.onnx", providers=["CPUExecutionProvider"])
    goals = np.random.default_rng(0).permutation(grid.n_cells)[:40]
    expected = parameters.values(grid, goals)
    cell, column = (axis.ravel() for axis in np.indices(expected.shape[:2]))
    feeds = {"position": grid.position(cell).astype(np.int64), "goal": grid.position(goals[column]).astype(np.int64)}
    values, action = session.run(["action_values", "action"], feeds)
    assert values.dtype == np.float32
    assert expected.std() > 0.1
    np.testing.assert_allclose(values, expected.reshape(values.shape), rtol=2e-5, atol=2e-5)
    np.testing.assert_array_equal(action, greedy_actions(values, tolerance=0.0))
    # another size of batch
    one = {name: rows[7:8] for name, rows in feeds.items()}
    np.testing.assert_allclose(session.run(["action_values"], one)[0], values[7:8], rtol=1e-5, atol=1e-5)
    about = session.get_modelmeta().custom_metadata_map
    assert about["grid_sides"] == " ".join(map(str, parameters.sides))
    assert about["actions"] == ("north south east west up down" if parameters.sides[2] > 1 else "north south east west")
    assert about["architecture"] == parameters.architecture
    assert json.loads(about["about"]) == json.loads(json.dumps(parameters.about))


def test_every_architecture_that_flies_can_be_exported() -> None:
    assert BUILDERS.keys() == TENSORS.keys()


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(onnx_file, "find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"pip install 'cellpilot\[onnx\]'"):
        save_onnx(POLICIES["concatenated 2D"], tmp_path / "policy.onnx")
    assert not list(tmp_path.iterdir())
