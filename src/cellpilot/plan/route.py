"""A route: what one deterministic policy flies between two cells, and what the radio is expected to be along it."""

import re
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from typing import Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.grid import IntArray, Position
from cellpilot.policies import Policy, greedy_actions
from cellpilot.task import Task
from cellpilot.world import World

REACHED, LOOPS, TIME_LIMIT, FORBIDDEN = "reached", "loops", "time limit", "enters a blocked cell"


@dataclass(frozen=True)
class Route:
    """Cells from start to end.

    `status`: reached, loops (came back to a cell, so it would circle for ever), time limit, or enters a blocked cell.
    """

    policy: str
    status: str
    cells: IntArray  # [steps + 1], the start included
    sinr_db: tuple[float | None, ...]  # map value in each cell, None where unknown
    low_probability: tuple[float, ...]  # chance of a measurement below the threshold, by cell
    shortest_steps: int
    length_m: float
    expected_return: float
    expected_low_share: float  # of the cells entered

    @property
    def n_steps(self) -> int:
        """Moves flown."""
        return len(self.cells) - 1


def plan_route(world: World, task: Task, policy: Policy, start: Position, goal: Position) -> Route:
    """Follow the most probable action of a policy from start to goal, at most `task.max_steps` moves.

    `InputError` for cells off the grid, blocked, equal or cut apart.
    """
    airspace = world.airspace
    starts, goals = airspace.start_goal_cells(start, goal)
    low = world.outage_probability(task.threshold_db)
    actions = greedy_actions(policy.action_probabilities(goals))[:, 0]
    cells, seen, total, status = [int(starts[0])], {int(starts[0])}, 0.0, TIME_LIMIT
    while len(cells) <= task.max_steps:
        action = int(actions[cells[-1]])
        reward, reached, terminated = task.expected_outcome(world, cells[-1], action, goals[0])
        total += float(reward)
        cells.append(int(airspace.next_cell[cells[-1], action]))
        if terminated:
            status = REACHED if reached else FORBIDDEN
            break
        if cells[-1] in seen:
            status = LOOPS
            break
        seen.add(cells[-1])
    metres = world.grid.metres(cells)
    sinr = world.signal.mean_db[cells]
    return Route(
        policy=policy.name,
        status=status,
        cells=np.asarray(cells, np.int32),
        sinr_db=tuple(float(v) if np.isfinite(v) else None for v in sinr),
        low_probability=tuple(float(p) for p in low[cells]),
        shortest_steps=int(airspace.shortest_steps(goals)[starts[0], 0]),
        length_m=float(np.linalg.norm(np.diff(metres, axis=0), axis=1).sum()),
        expected_return=total,
        expected_low_share=float(low[cells[1:]].mean()),
    )


def route_payload(route: Route, world: World, latitude_longitude: Any = None) -> dict[str, Any]:
    """The route as plain data for JSON; `latitude_longitude(x_m, y_m)` adds geographic coordinates where given."""
    summary = asdict(route)
    for name in ("cells", "sinr_db", "low_probability"):
        summary.pop(name)
    steps = []
    for position, (x_m, y_m, z_m), sinr_db, low in zip(
        world.grid.position(route.cells), world.grid.metres(route.cells), route.sinr_db, route.low_probability, strict=True
    ):
        step: dict[str, Any] = {"position": position.tolist(), "x_m": x_m, "y_m": y_m, "z_m": z_m}
        if latitude_longitude is not None:
            latitude_deg, longitude_deg = latitude_longitude(x_m, y_m)
            step |= {"latitude_deg": float(latitude_deg), "longitude_deg": float(longitude_deg)}
        steps.append(step | {"sinr_db": sinr_db, "low_probability": low})
    ratio = route.n_steps / route.shortest_steps if route.status == REACHED else None
    return summary | {"n_steps": route.n_steps, "path_ratio": ratio, "steps": steps}


EXPECTED = (
    "expected three cells like 12,9,0, metres like -50m,120m,30m, or latitude, longitude and altitude like 3.1,101.7,30"
    " (whole degrees: 3deg,101deg,30m)"
)
PART = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)\s*(m|deg|c)?", re.IGNORECASE)
Local = Callable[[float, float], tuple[Any, Any]]


def parse_place(text: str, what: str, world: World, to_local: Local | None = None) -> Position:
    """Position of `IX,IY,IZ` (cells), `Xm,Ym,Zm` (metres) or `LATITUDE,LONGITUDE,ALTITUDE` (degrees, needs an anchored map).

    Three whole numbers are cells (`c` on each says so), an `m` on each number means metres; numbers with a decimal point or
    `deg` are geographic. `InputError` for whole numbers that could be either: a cell of the map and a place on it.
    `to_local(latitude_deg, longitude_deg)` returns metres; None on a map without an anchor.
    """
    found = [PART.fullmatch(part.strip()) for part in text.split(",")]
    if len(found) != 3 or None in found:
        raise InputError(f"{what} is {text!r}; {EXPECTED}")
    numbers, units = zip(*((part[1], (part[2] or "").lower()) for part in found if part), strict=True)
    if not all(isfinite(float(number)) for number in numbers):
        raise InputError(f"{what} is {text!r}; expected finite numbers")
    whole = all(number.lstrip("+-").isdigit() for number in numbers)
    try:
        if set(units) == {"c"} or (set(units) == {""} and whole):
            if not whole:
                raise InputError(EXPECTED)
            return _cell(numbers, world, to_local if set(units) == {""} else None)
        if set(units) == {"m"}:
            x_m, y_m, z_m = map(float, numbers)
            return world.grid.nearest_position((x_m, y_m, z_m))
        if units[:2] in (("deg", "deg"), ("", "")) and units[2] in ("", "m"):
            return _geographic(numbers, world, to_local)
    except InputError as error:
        raise InputError(f"{what} {text}: {error}") from None
    raise InputError(f"{what} is {text!r}; {EXPECTED}")


def _cell(numbers: Sequence[str], world: World, to_local: Local | None) -> Position:
    """A cell; `InputError` if the numbers are those of a place on the map as well, or of one that only degrees can mean."""
    position = tuple(int(number) for number in numbers)
    degrees = f"{numbers[0]}deg,{numbers[1]}deg,{numbers[2]}m"
    try:
        cell = world.grid.check_position(position, "position")
    except InputError as error:
        raise InputError(f"{error} (whole numbers are cells; degrees: {degrees})" if to_local else str(error)) from None
    if to_local is not None and _is_on_the_map(numbers, world, to_local):
        cells = ",".join(f"{number}c" for number in numbers)
        raise InputError(f"a cell, and in degrees a place on the map; write {cells} for the cell or {degrees} for the place")
    return cell


def _is_on_the_map(numbers: Sequence[str], world: World, to_local: Local) -> bool:
    try:
        _geographic(numbers, world, to_local)
    except InputError:
        return False
    return True


def _geographic(numbers: Sequence[str], world: World, to_local: Local | None) -> Position:
    latitude_deg, longitude_deg, altitude_m = map(float, numbers)
    if to_local is None:
        raise InputError("looks like latitude,longitude,altitude, but the map has no anchor; give cells or metres")
    if not (-90 <= latitude_deg <= 90 and -180 <= longitude_deg <= 180):
        raise InputError("expected a latitude within -90..90 and a longitude within -180..180")
    x_m, y_m = (float(metres) for metres in to_local(latitude_deg, longitude_deg))
    return world.grid.nearest_position((x_m, y_m, altitude_m))
