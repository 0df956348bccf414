"""A trained policy as an ONNX file (extra `onnx`), built from its weights node by node.

Inputs `position` and `goal`, int64 `[batch, 3]`, positions `(ix, iy, iz)` on the grid; outputs `action_values`, float32
`[batch, actions]`, and `action`, int64 `[batch]`, the first of the highest. What is outside the grid has no meaning.
"""

import json
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.policies import pair_value, tables
from cellpilot.policies.learned import POLICY_FORMAT, PolicyParameters
from cellpilot.provenance import versions
from cellpilot.storage import write_atomically
from cellpilot.task import Task

OPSET, IR_VERSION = 17, 8
"""Of 2022: read by every runtime since."""


def save_onnx(parameters: PolicyParameters, path: Path) -> None:
    """Write the policy as ONNX, atomically; `InputError` if the extra is missing."""
    model = make_onnx(parameters)
    write_atomically(path, model.SerializeToString())


def make_onnx(parameters: PolicyParameters) -> Any:
    """The policy as `onnx.ModelProto`, its metadata with the sides of the grid and the names of the actions."""
    if find_spec("onnx") is None:
        raise InputError("ONNX export needs the extra onnx: pip install 'cellpilot[onnx]'")
    import onnx

    graph = _Graph()
    position, goal = graph.value("position"), graph.value("goal")
    airspace = parameters.airspace(_grid(parameters))
    values = BUILDERS[parameters.architecture](graph, parameters, position, goal)
    if airspace.rule == "mask":
        offered = graph.op("Gather", np.where(airspace.offered, 0.0, -np.inf), _cell(graph, parameters, position))
        values = values + offered
    graph.name_output(values, "action_values")
    graph.name_output(graph.op("ArgMax", values, axis=-1, keepdims=0), "action")
    describe = onnx.helper.make_tensor_value_info
    integer, real = onnx.TensorProto.INT64, onnx.TensorProto.FLOAT
    model = onnx.helper.make_model(
        onnx.helper.make_graph(
            graph.nodes,
            "policy",
            [describe(name, integer, ["batch", 3]) for name in ("position", "goal")],
            [describe("action_values", real, ["batch", airspace.n_actions]), describe("action", integer, ["batch"])],
            graph.constants,
        ),
        opset_imports=[onnx.helper.make_opsetid("", OPSET)],
        ir_version=IR_VERSION,
        producer_name="cellpilot",
        producer_version=versions().get("cellpilot", ""),
    )
    onnx.helper.set_model_props(
        model,
        {
            "format": POLICY_FORMAT,
            "architecture": parameters.architecture,
            "grid_sides": " ".join(map(str, parameters.sides)),
            "actions": " ".join(airspace.moves.names),
            "about": json.dumps(parameters.about),
        },
    )
    onnx.checker.check_model(model, full_check=True)
    return model


class _Graph:
    """Nodes and constants so far; every method that computes returns the value it adds."""

    def __init__(self) -> None:
        self.nodes: list[Any] = []
        self.constants: list[Any] = []

    def value(self, name: str) -> "_Value":
        return _Value(self, name)

    def constant(self, content: ArrayLike) -> "_Value":
        """A constant; numbers are kept as int64 or float32."""
        import onnx

        array = np.asarray(content)
        array = array.astype(np.float32 if np.issubdtype(array.dtype, np.floating) else np.int64)
        name = f"c{len(self.constants)}"
        self.constants.append(onnx.numpy_helper.from_array(array, name))
        return _Value(self, name)

    def op(self, kind: str, *inputs: "_Value | ArrayLike", **attributes: Any) -> "_Value":
        """One node; numbers and arrays among the inputs become constants."""
        import onnx

        names = [(value if isinstance(value, _Value) else self.constant(value)).name for value in inputs]
        name = f"v{len(self.nodes)}"
        self.nodes.append(onnx.helper.make_node(kind, names, [name], **attributes))
        return _Value(self, name)

    def as_float(self, value: "_Value") -> "_Value":
        import onnx

        return self.op("Cast", value, to=onnx.TensorProto.FLOAT)

    def name_output(self, value: "_Value", name: str) -> None:
        import onnx

        self.nodes.append(onnx.helper.make_node("Identity", [value.name], [name]))


class _Value:
    """A tensor in the graph, with the arithmetic that `policies.pair_value` shares between NumPy, JAX and this."""

    def __init__(self, graph: _Graph, name: str):
        self.graph, self.name = graph, name

    def __add__(self, other: Any) -> "_Value":
        return self.graph.op("Add", self, other)

    def __sub__(self, other: Any) -> "_Value":
        return self.graph.op("Sub", self, other)

    def __mul__(self, other: Any) -> "_Value":
        return self.graph.op("Mul", self, other)

    def __mod__(self, other: Any) -> "_Value":
        return self.graph.op("Mod", self, other)

    def __floordiv__(self, other: Any) -> "_Value":
        return self.graph.op("Div", self, other)  # of integers that are not negative, so it rounds down

    def __abs__(self) -> "_Value":
        return self.graph.op("Abs", self)

    __radd__, __rmul__ = __add__, __mul__


def _concatenated(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    return _perceptron(graph, parameters, "network", _side_by_side(graph, parameters, position, goal))


def _dueling(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    hidden = _perceptron(graph, parameters, "trunk", _side_by_side(graph, parameters, position, goal))
    hidden = graph.op("LeakyRelu", hidden, alpha=0.01)
    width = parameters.tensors["value.layers.0.weight"].shape[1]
    value = _perceptron(graph, parameters, "value", graph.op("Gather", hidden, np.arange(width), axis=-1))
    advantage = _perceptron(graph, parameters, "advantage", graph.op("Gather", hidden, width + np.arange(width), axis=-1))
    return value + advantage - graph.op("ReduceMean", advantage, axes=[-1])


def _two_stream(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    phi = _perceptron(graph, parameters, "phi", _coordinates(graph, parameters, position))
    psi = _perceptron(graph, parameters, "psi", _coordinates(graph, parameters, goal))
    n_features = _layers(parameters, "psi")[-1][1].size
    by_action = graph.op("Reshape", phi, [0, -1, n_features])
    return graph.op("ReduceSum", by_action * graph.op("Unsqueeze", psi, [1]), [-1], keepdims=0)


def _side_by_side(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    return graph.op("Concat", _coordinates(graph, parameters, position), _coordinates(graph, parameters, goal), axis=-1)


def _coordinates(graph: _Graph, parameters: PolicyParameters, position: _Value) -> _Value:
    """Positions as the networks see them: of the dimensions flown, counted from 1, divided by the side."""
    used = [0, 1, 2] if parameters.sides[2] > 1 else [0, 1]
    counted = graph.as_float(graph.op("Gather", position, used, axis=1) + 1)
    return graph.op("Div", counted, np.array([parameters.sides[i] for i in used], np.float32))


def _perceptron(graph: _Graph, parameters: PolicyParameters, name: str, x: _Value) -> _Value:
    layers = _layers(parameters, name)
    for i, (weight, bias) in enumerate(layers):
        x = graph.op("Gemm", x, weight, bias, transB=1)
        if i < len(layers) - 1:
            x = graph.op("LeakyRelu", x, alpha=0.01)
    return x


def _layers(parameters: PolicyParameters, name: str) -> list[tuple[Any, Any]]:
    tensors = parameters.tensors
    n_layers = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in tensors)
    return [(tensors[f"{name}.layers.{i}.weight"], tensors[f"{name}.layers.{i}.bias"]) for i in range(n_layers)]


def _pair_value(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    """`pair_value.pair_action_values` for the pairs asked for: of the cells entered, or with look-ahead of all cells."""
    task, tensors = Task(**parameters.about["task"]), parameters.tensors
    airspace = parameters.airspace(Grid(*(tuple(map(float, range(n))) for n in parameters.sides)))
    cell, goal = _cell(graph, parameters, position), graph.op("Unsqueeze", _cell(graph, parameters, goal), [-1])
    next_table = graph.constant(airspace.next_cell)
    # A move that is not offered is masked where the values are complete; within, what is added has to stay finite.
    of_move = np.maximum(pair_value.move_rewards(airspace, task), np.finfo(np.float32).min / 4)
    move_table = graph.constant(of_move)
    goes_on = graph.constant(np.where(airspace.blocked & airspace.ends, 0.0, 1.0))

    def reward_and_future(cell: _Value) -> tuple[_Value, _Value]:
        """Reward of entering the cells, and what counts of their value: the discount, or nothing where flights end."""
        at_goal = graph.as_float(graph.op("Equal", cell, goal))
        low = graph.op("Gather", tensors["penalty"], cell) if "penalty" in tensors else 0.0
        going = graph.op("Sub", np.float32(1), at_goal) * graph.op("Gather", goes_on, cell)
        return task.entering_reward(cell, low, at_goal), going * np.float32(task.discount)

    def entering(cell: _Value, reward: _Value, future: _Value) -> _Value:
        """What the network says entering the cells is worth."""
        diagonal = airspace.moves.diagonal
        correction, bound = _correction(graph, parameters, cell, goal), _bound(graph, parameters, task, cell, goal, diagonal)
        if "penalty" not in tensors:
            most = reward + bound * np.float32(task.discount)
            value = graph.op("Min", most + correction, most)
            return reward + (value - reward) * graph.op("Gather", goes_on, cell) if airspace.ends else value
        return reward + graph.op("Min", bound + correction, bound) * future

    entered = graph.op("Gather", next_table, cell)
    further_moves = int(parameters.about["look_ahead"]) - 1
    if not further_moves:
        return entering(entered, *reward_and_future(entered)) + graph.op("Gather", move_table, cell)
    everywhere = graph.constant(np.arange(airspace.grid.n_cells)[None, :])
    reward, future = reward_and_future(everywhere)
    values = entering(everywhere, reward, future)
    for _ in range(further_moves):
        of_moves = graph.op("Gather", values, next_table, axis=1) + move_table
        values = reward + graph.op("ReduceMax", of_moves, axes=[-1], keepdims=0) * future
    return graph.op("GatherElements", values, entered, axis=1) + graph.op("Gather", move_table, cell)


def _correction(graph: _Graph, parameters: PolicyParameters, cell: _Value, goal: _Value) -> _Value:
    """The least output of the networks for pairs `[...]`."""
    rows = pair_value.pair_rows(parameters.sides, cell, goal)
    outputs = []
    for table, weight, bias, output in zip(*(parameters.tensors[n] for n in ("table", "weight", "bias", "output")), strict=True):
        table_rows = [graph.op("Gather", graph.constant(table), row) for row in rows]
        hidden = graph.op("Relu", graph.op("Sum", *table_rows))
        hidden = graph.op("Relu", graph.op("MatMul", hidden, weight) + bias)
        outputs.append(graph.op("Squeeze", graph.op("MatMul", hidden, output[:, None]), [-1]))
    return graph.op("Min", *outputs)


def _cell(graph: _Graph, parameters: PolicyParameters, position: _Value) -> _Value:
    nx, ny, _ = parameters.sides
    return graph.op("ReduceSum", position * np.array([1, nx, nx * ny]), [-1], keepdims=0)


def _bound(graph: _Graph, parameters: PolicyParameters, task: Task, cell: _Value, goal: _Value, diagonal: bool) -> _Value:
    """`pair_value.upper_bound`, looked up by the number of moves; it is linear in the penalty of the goal."""
    moves = pair_value.distance(parameters.sides, cell, goal, diagonal)
    steps = np.arange(sum(parameters.sides) + 1, dtype=np.float64)
    plain = pair_value.upper_bound(task, steps, 0.0)
    bound = graph.op("Gather", plain, moves)
    if "penalty" in parameters.tensors:
        share = graph.op("Gather", pair_value.upper_bound(task, steps, 1.0) - plain, moves)
        bound = bound + share * graph.op("Gather", parameters.tensors["penalty"], goal)
    return bound


def _table(graph: _Graph, parameters: PolicyParameters, position: _Value, goal: _Value) -> _Value:
    """The values of all cells and goals, computed here and looked up there."""
    n_cells = int(np.prod(parameters.sides))
    values = parameters.values(_grid(parameters), np.arange(n_cells, dtype=np.int32))
    rows = np.maximum(values, np.finfo(np.float32).min).reshape(n_cells * n_cells, -1)
    return graph.op("Gather", graph.constant(rows), _cell(graph, parameters, position) * n_cells + _cell(graph, parameters, goal))


def _grid(parameters: PolicyParameters) -> Grid:
    """A grid of the policy's sides; its metres do not matter."""
    return Grid(*(tuple(map(float, range(n))) for n in parameters.sides))


Builder = Callable[[_Graph, PolicyParameters, _Value, _Value], _Value]
BUILDERS: dict[str, Builder] = {
    "concatenated": _concatenated,
    "two-stream": _two_stream,
    "dueling": _dueling,
    pair_value.ARCHITECTURE: _pair_value,
    **dict.fromkeys(tables.TABLE_TENSORS, _table),
}
"""What computes the action values of each architecture, from graph, parameters, position and goal."""
