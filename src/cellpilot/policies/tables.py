"""Policies that need no network: a table of values, and a map as it is believed, planned on exactly where one flies."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import Airspace
from cellpilot.grid import IntArray
from cellpilot.signal import Signal, Unknown
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

Q_TABLE, BELIEVED_MAP = "q-table", "believed-map"
TABLE_TENSORS = {Q_TABLE: {"q"}, BELIEVED_MAP: {"mean_db", "std_db", "blocked"}}
"""`q [n_cells, goals, actions]`, one goal for each cell; `mean_db` and `std_db [n_cells]` of the map, `blocked [n_cells]`."""


def table_shapes(architecture: str, n_cells: int, n_actions: int) -> dict[str, tuple[int | str, ...]]:
    """Shape of each tensor."""
    if architecture == Q_TABLE:
        return {"q": (n_cells, n_cells, n_actions)}
    return dict.fromkeys(TABLE_TENSORS[BELIEVED_MAP], (n_cells,))


def check_belief(about: Mapping[str, Any]) -> None:
    """`ValueError` unless the description has the noise of a measurement and the discount of the plans."""
    noise_std_db, discount = about["noise_std_db"], about["discount"]
    if not isinstance(noise_std_db, int | float) or not 0 <= noise_std_db < np.inf:
        raise ValueError(f"noise_std_db is {noise_std_db!r:.40}; expected a finite number, 0 or more")
    if not isinstance(discount, int | float) or not 0 < discount <= 1:
        raise ValueError(f"discount is {discount!r:.40}; expected 0 < discount <= 1")


def table_values(
    architecture: str, tensors: Mapping[str, NDArray[Any]], airspace: Airspace, goals: IntArray, about: Mapping[str, Any]
) -> NDArray[np.float32]:
    """Q(cell, goal, action) `[n_cells, goals, actions]`: looked up, or the exact values on the believed map."""
    if architecture == Q_TABLE:
        return np.asarray(tensors["q"][:, goals], np.float32)
    unknown = Unknown.of(airspace.grid, tensors["std_db"], 0.0)  # a plan asks for the chance of each cell alone
    world = World(airspace, Signal(tensors["mean_db"], about["noise_std_db"], unknown))
    return optimal_values(world, Task(**about["task"]), np.asarray(goals), about["discount"]).astype(np.float32)
