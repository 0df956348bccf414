"""A trained policy, flown on NumPy alone: `policy.safetensors`, tensors and a JSON description in its header."""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import MOVE_SETS, Airspace, usual_moves
from cellpilot.errors import InputError
from cellpilot.grid import Grid, IntArray
from cellpilot.policies import pair_value, tables
from cellpilot.policies.base import greedy_actions, one_hot
from cellpilot.policies.check import check_look_ahead, check_moves, check_sides, check_task, check_tensors
from cellpilot.storage import load_tensors, save_tensors
from cellpilot.task import Task

POLICY_FORMAT = "cellpilot-policy-1"
POLICY_HEADER = {"architecture", "sides", "about"}
TENSORS = {
    "concatenated": {"network.layers.0.weight", "network.layers.0.bias"},
    "two-stream": {"phi.layers.0.weight", "phi.layers.0.bias", "psi.layers.0.weight", "psi.layers.0.bias"},
    "dueling": {f"{part}.layers.0.{kind}" for part in ("trunk", "value", "advantage") for kind in ("weight", "bias")},
    pair_value.ARCHITECTURE: pair_value.PAIR_TENSORS,
    **tables.TABLE_TENSORS,
}
"""Architectures this file can fly, and the tensors that each has at least."""
Array32 = NDArray[np.float32]
MOST_VALUES = 64_000_000
"""Of one layer, for all pairs of cell and goal that are computed at once (256 MB)."""


@dataclass(frozen=True)
class PolicyParameters:
    """Weights by name (`network.layers.0.weight`, ...) and what they were trained for."""

    tensors: dict[str, Array32]
    architecture: str  # a key of TENSORS
    sides: tuple[int, int, int]
    about: dict[str, Any] = field(default_factory=dict)  # scenario, map digest, task, seed
    checked: bool = True  # False for one that was read from a file without a checksum

    def check_airspace(self, airspace: Airspace) -> None:
        """`InputError` if the policy was trained on a grid of another shape, for other moves or under another rule."""
        self.check_grid(airspace.grid)
        here, there = self.airspace(airspace.grid), airspace
        if here.n_actions != there.n_actions:
            raise InputError(f"the policy was trained with {here.n_actions} moves, not {there.n_actions}: train with these")
        if here.rule != there.rule and there.blocked.any():
            rules = f"under the rule {here.rule!r} for forbidden moves, not {there.rule!r}"
            raise InputError(f"the policy was trained {rules}: train under this one")

    def airspace(self, grid: Grid) -> Airspace:
        """Where the policy takes it that one may fly, on a grid of its shape."""
        blocked = self.tensors.get("blocked", np.zeros(grid.n_cells, bool)).astype(bool)
        n_moves = self.about.get("n_moves")
        return Airspace.of_blocked(grid, blocked, self.about.get("rule", "stay"), None if n_moves is None else MOVE_SETS[n_moves])

    def trained_in(self, airspace: Airspace) -> "PolicyParameters":
        """The same policy, with the moves and the rule that it was trained for where they are not the usual ones."""
        about, tensors = dict(self.about), dict[str, Any](self.tensors)
        if airspace.moves != usual_moves(airspace.grid):
            about["n_moves"] = airspace.n_actions
        if airspace.rule != "stay":
            about["rule"] = airspace.rule
            tensors["blocked"] = airspace.blocked
        return replace(self, about=about, tensors=tensors)

    def check_grid(self, grid: Grid) -> None:
        """`InputError` if the policy was trained on a grid of another shape."""
        if grid.sides != self.sides:
            trained, found = (" x ".join(map(str, sides)) for sides in (self.sides, grid.sides))
            raise InputError(f"the policy was trained on {trained} cells, the map has {found}: train on this map")

    def values(self, grid: Grid, goals: IntArray) -> Array32:
        """Q(cell, goal, action) `[n_cells, goals, actions]` in float32, -inf for an action that is not offered.

        `InputError` on a grid of another shape.
        """
        self.check_grid(grid)
        airspace = self.airspace(grid)
        values = self._values(airspace, goals)
        if airspace.rule == "mask":
            values = np.where(airspace.offered[:, None, :], values, np.float32(-np.inf))
        return values

    def _values(self, airspace: Airspace, goals: IntArray) -> Array32:
        grid = airspace.grid
        at_once = max(1, MOST_VALUES // (grid.n_cells * self._width))
        if len(goals) > at_once:
            blocks = [goals[i : i + at_once] for i in range(0, len(goals), at_once)]
            return np.concatenate([self._values(airspace, block) for block in blocks], axis=1)
        if self.architecture == pair_value.ARCHITECTURE:
            task = Task(**self.about["task"])
            return pair_value.pair_action_values(self.tensors, airspace, task, goals, self.about["look_ahead"])
        if self.architecture in tables.TABLE_TENSORS:
            return tables.table_values(self.architecture, self.tensors, airspace, goals, self.about)
        n_dimensions = grid.n_dimensions
        position = grid.position(np.arange(grid.n_cells))[:, :n_dimensions]
        coordinates = ((position + 1) / np.asarray(grid.sides[:n_dimensions])).astype(np.float32)
        here, there = coordinates[:, None, :], coordinates[np.asarray(goals)][None, :, :]
        if self.architecture == "two-stream":
            phi, psi = self._perceptron("phi", here), self._perceptron("psi", there)
            return np.einsum("cgak,ngk->cga", phi.reshape(*phi.shape[:2], -1, psi.shape[-1]), psi)
        pair = np.concatenate(np.broadcast_arrays(here, there), axis=-1)
        if self.architecture == "dueling":
            for_value, for_advantage = np.split(_leaky_relu(self._perceptron("trunk", pair)), 2, axis=-1)
            advantage = self._perceptron("advantage", for_advantage)
            return self._perceptron("value", for_value) + advantage - advantage.mean(-1, keepdims=True)
        return self._perceptron("network", pair)

    @property
    def _width(self) -> int:
        """Numbers that the widest layer keeps for a pair."""
        return max((tensor.shape[-1] for tensor in self.tensors.values() if tensor.ndim > 1), default=1)

    def _perceptron(self, name: str, x: Array32) -> Array32:
        """Leaky-ReLU perceptron (section 3.2.1) over the last axis."""
        n_layers = sum(key.startswith(f"{name}.") and key.endswith(".weight") for key in self.tensors)
        for i in range(n_layers):
            x = x @ self.tensors[f"{name}.layers.{i}.weight"].T + self.tensors[f"{name}.layers.{i}.bias"]
            if i < n_layers - 1:
                x = _leaky_relu(x)
        return x


def _leaky_relu(x: Array32) -> Array32:
    return np.maximum(x, np.float32(0.01) * x)


@dataclass(frozen=True)
class LearnedPolicy:
    """Arg max of the learned values, or the Boltzmann distribution over them at a temperature (equation 3.15)."""

    parameters: PolicyParameters
    grid: Grid
    temperature: float | None = None

    @property
    def name(self) -> str:
        """`learned/argmax` or `learned/boltzmann-T`."""
        return "learned/argmax" if self.temperature is None else f"learned/boltzmann-{self.temperature:g}"

    @property
    def deterministic(self) -> bool:
        """True for arg max."""
        return self.temperature is None

    def action_probabilities(self, goals: IntArray) -> Array32:
        """Probabilities `[n_cells, goals, actions]`."""
        values = self.parameters.values(self.grid, goals)
        if self.temperature is None:
            return one_hot(greedy_actions(values, tolerance=0.0), values.shape[-1])
        best = np.maximum(values.max(-1, keepdims=True), np.finfo(np.float32).min)  # finite where no action is offered
        weights = np.exp((values - best) / np.float32(self.temperature))
        return weights / weights.sum(-1, keepdims=True)


def save_parameters(parameters: PolicyParameters, path: Path) -> None:
    """Write `policy.safetensors` atomically."""
    header = {"architecture": parameters.architecture, "sides": parameters.sides, "about": parameters.about}
    save_tensors(path, parameters.tensors, POLICY_FORMAT, header)


def load_parameters(path: Path) -> PolicyParameters:
    """Read `policy.safetensors`; `InputError` for a missing file, a damaged one or one of another kind."""
    remedy = "train again or restore it"
    tensors, header = load_tensors(path, POLICY_FORMAT, POLICY_HEADER, remedy)
    try:
        sides = check_sides(header["sides"])
        architecture, about = header["architecture"], dict(header["about"])
        expected = TENSORS[architecture]
        if architecture == pair_value.ARCHITECTURE:
            check_task(about)
            check_look_ahead(about, sides)
        elif architecture == tables.BELIEVED_MAP:
            check_task(about)
            tables.check_belief(about)
        check_moves(about)
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: the description of the policy is damaged ({error!r:.120}); {remedy}") from error
    if not expected <= tensors.keys():
        raise InputError(f"{path}: tensors {sorted(expected - tensors.keys())} are missing; {remedy}")
    try:
        check_tensors(tensors, architecture, sides, about)
    except KeyError as error:
        raise InputError(f"{path}: the tensor {error.args[0]} is missing; {remedy}") from None
    except InputError as error:
        raise InputError(f"{path}: {error}; {remedy}") from None
    return PolicyParameters(tensors, architecture, sides, about, checked="digest" in header)
