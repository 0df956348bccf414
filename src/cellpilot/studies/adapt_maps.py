"""The two maps of `cellpilot adapt`, brought onto one grid."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.experiment import build_map
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner import without_holes
from cellpilot.learn.algorithms.map_learner_settings import MOST_LEARNED_CELLS
from cellpilot.scenario import (
    MapFile,
    MapSettings,
    MeasuredMap,
    RewardSettings,
    Scenario,
    SimulatedMap,
    find_scenario,
    load_scenario,
)
from cellpilot.task import Task
from cellpilot.world import World

if TYPE_CHECKING:
    from cellpilot.maps import RadioMap
from cellpilot.studies.adapt_arms import Transfer

WHOLE_AREA_M = 100_000.0
"""Holes of a log given as such are filled from neighbours this near: all of them, so that B has a truth everywhere."""


def read_place(text: str, bin_m: float) -> tuple[MapSettings, Scenario | None]:
    """What A or B names: a RadioMap file (any but .csv), a measured log (.csv), or a scenario by file or name."""
    from cellpilot.maps.files import is_map

    suffix = Path(text).suffix.lower()
    if is_map(Path(text)) and suffix != ".csv":
        return MapFile(path=Path(text)), None
    if suffix == ".csv":
        return MeasuredMap(logs=(Path(text),), bin_m=bin_m, fill_radius_m=WHOLE_AREA_M), None
    scenario = load_scenario(find_scenario(text))
    return scenario.map, scenario


def rewards_of(scenario: Scenario) -> RewardSettings:
    """The task of a scenario; flights lead between random places, so one that fixes start or goal is refused."""
    if scenario.task.start is not None or scenario.task.goal is not None:
        raise InputError(f"the scenario {scenario.name} fixes start or goal; adapt flies between random places: leave them out")
    return RewardSettings(**scenario.task.model_dump(include=set(RewardSettings.model_fields)))


def make_transfer_maps(a: MapSettings, b: MapSettings, calibration: MapSettings | None = None) -> tuple["RadioMap", "RadioMap"]:
    """Maps A and B on their common grid.

    Where B is measured, a simulated A is simulated on the grid of B, and a measured A is gridded in the bins of B. Of
    two maps of one height each, A may be of another height than B. Only the rectangle that both cover is kept. With
    `calibration` (a map of the same network that is known beforehand, such as another height), a constant is added to
    A that makes its mean that of the calibration. `InputError` if the grids cannot be brought together.
    """
    map_b = build_map(b)
    map_a = _beside(a, map_b)
    if calibration is not None:
        known = _beside(calibration, map_b)["sinr_db"].values
        map_a = map_a.assign(sinr_db=map_a["sinr_db"] + np.float32(np.nanmean(known) - np.nanmean(map_a["sinr_db"].values)))
    return common_grid(map_a, map_b)


def _beside(settings: MapSettings, other: "RadioMap") -> "RadioMap":
    """The map of the settings, in the bins of the other one where it can be chosen."""
    from cellpilot.maps import anchor_of

    if isinstance(settings, SimulatedMap) and other.attrs["source"] != "simulation":
        x_m, y_m = other["x"].values, other["y"].values
        if min(x_m.size, y_m.size) < 2:
            raise InputError("map B has a single row of cells: nothing to simulate on")
        half_m = (x_m[1] - x_m[0]) / 2
        on_grid = {
            "x_range_m": (float(x_m[0] - half_m), float(x_m[-1] + half_m)),
            "y_range_m": (float(y_m[0] - half_m), float(y_m[-1] + half_m)),
            "bin_m": float(2 * half_m),
            "heights_m": tuple(float(z) for z in other["z"].values),
        }
        return build_map(settings.changed(**on_grid))
    return build_map(settings, anchor_of(other))


def common_grid(map_a: "RadioMap", map_b: "RadioMap") -> tuple["RadioMap", "RadioMap"]:
    """Both maps cut to the cells they share; `InputError` if their bins do not coincide or nothing is shared."""
    from cellpilot.maps import anchor_of

    anchors = anchor_of(map_a), anchor_of(map_b)
    if None not in anchors and anchors[0] != anchors[1]:
        places = [f"{anchor.latitude_deg:.6f}, {anchor.longitude_deg:.6f}" for anchor in anchors if anchor is not None]
        raise InputError(
            f"x = y = 0 lies at {places[0]} in one map and at {places[1]} in the other:"
            " give the logs, or import both with one anchor"
        )
    heights = map_a["z"].values, map_b["z"].values
    if len(heights[0]) == len(heights[1]) == 1:
        map_a = map_a.assign_coords(z=map_b["z"])
    elif not np.array_equal(*heights):
        shown = [", ".join(f"{z:g}" for z in z_m) for z_m in heights]
        raise InputError(f"the grids differ: heights {shown[0]} m in A, {shown[1]} m in B; expected the same")
    ranges = {axis: _shared(axis, map_a[axis].values, map_b[axis].values) for axis in "xy"}
    return tuple(m.isel({axis: slice(*ranges[axis][i]) for axis in "xy"}) for i, m in enumerate((map_a, map_b)))  # type: ignore[return-value]


def _shared(axis: str, a_m: np.ndarray, b_m: np.ndarray) -> tuple[tuple[int, int], tuple[int, int]]:
    """First and last index (exclusive) of the shared centres in each of two axes."""
    sides = [float(m[1] - m[0]) if len(m) > 1 else None for m in (a_m, b_m)]
    if None not in sides and not np.isclose(sides[0], sides[1]):  # type: ignore[arg-type]
        raise InputError(f"the grids differ: bins of {sides[0]:g} m in A, {sides[1]:g} m in B along {axis}; expected the same")
    shared = [i for i, centre in enumerate(a_m) if np.isclose(b_m, centre, rtol=0, atol=1e-3).any()]
    if not shared:
        where = [f"{m[0]:g} to {m[-1]:g}" for m in (a_m, b_m)]
        raise InputError(f"the grids differ: centres along {axis} from {where[0]} m in A, {where[1]} m in B; none is shared")
    first = int(np.flatnonzero(np.isclose(b_m, a_m[shared[0]], rtol=0, atol=1e-3))[0])
    return (shared[0], shared[-1] + 1), (first, first + len(shared))


def make_transfer(map_a: "RadioMap", map_b: "RadioMap", task: Task, noise_std_db: float, deep: FQIHER | None = None) -> Transfer:
    """The transfer between two maps of one grid; holes of A are its mean at their height.

    What is uncertain about a measured B is set aside: its map is the truth. `InputError` for a map that is too large.
    """
    truth = World.from_map(map_b, noise_std_db)
    if truth.grid.n_cells > MOST_LEARNED_CELLS:
        raise InputError(
            f"the maps have {truth.grid.n_cells:,} cells; adapt can hold {MOST_LEARNED_CELLS:,}: use larger bins or a part"
        )
    truth = replace(truth, signal=replace(truth.signal, unknown=None))
    prepared_db = without_holes(truth.grid, map_a["sinr_db"].values.ravel().astype(np.float64), task.threshold_db)
    prepared = replace(truth, signal=replace(truth.signal, mean_db=prepared_db.astype(np.float32)))
    return Transfer(task, prepared, truth, deep or FQIHER())
