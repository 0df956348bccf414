"""`Airspace`: where a drone may fly, how it moves, and why not. Nothing here depends on the radio.

Everything is computed when it is first asked for. NumPy and SciPy only.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components, dijkstra

from cellpilot.errors import InputError
from cellpilot.grid import Grid, IntArray, Position
from cellpilot.maps.reasons import MARKED, Reason

MOVED, BORDER, STOPPED, ENTERED, MASKED = range(5)
"""What became of a move: flown; kept in place by the border of the grid; kept in place by a blocked cell; flown into a blocked
cell, where the flight ends; not offered."""

Rule = Literal["stay", "mask", "end"]
USUAL_RULE: Rule = "stay"
"""What a forbidden move does: it stays in place, it is not offered, or it enters the blocked cell and the flight ends."""


@dataclass(frozen=True)
class Moves:
    """The moves of a drone: their names, and the step `(dx, dy, dz)` in cells of each. The order breaks ties."""

    names: tuple[str, ...]
    offsets: tuple[Position, ...]

    def __len__(self) -> int:
        return len(self.names)

    @cached_property
    def array(self) -> IntArray:
        """Steps in cells, `[actions, 3]`."""
        return np.array(self.offsets, dtype=np.int32)

    @cached_property
    def diagonal(self) -> bool:
        """Whether some move changes more than one coordinate."""
        return bool((np.abs(self.array).sum(1) > 1).any())

    @cached_property
    def climbs(self) -> bool:
        """Whether some move changes the height."""
        return bool(self.array[:, 2].any())

    def steps(self, displacement: Any) -> Any:
        """Moves that a displacement `[..., 3]` in cells needs where nothing is blocked."""
        away = abs(displacement)
        return away.max(-1) if self.diagonal else away.sum(-1)


_AXES = {"north": (0, 1, 0), "south": (0, -1, 0), "east": (1, 0, 0), "west": (-1, 0, 0), "up": (0, 0, 1), "down": (0, 0, -1)}


def _named(offset: tuple[int, ...]) -> str:
    parts = {(2, 1): "up", (2, -1): "down", (1, 1): "north", (1, -1): "south", (0, 1): "east", (0, -1): "west"}
    return "-".join(parts[axis, offset[axis]] for axis in (2, 1, 0) if offset[axis])


def _with_diagonals(straight: list[Position], heights: tuple[int, ...]) -> Moves:
    every = [(x, y, z) for z, y, x in product(heights, (1, 0, -1), (1, 0, -1))]
    offsets = straight + [offset for offset in every if np.abs(offset).sum() > 1]
    return Moves(tuple(_named(offset) for offset in offsets), tuple(offsets))


_STRAIGHT = list(_AXES.values())
MOVE_SETS: dict[int, Moves] = {
    4: Moves(tuple(_AXES)[:4], tuple(_STRAIGHT[:4])),
    6: Moves(tuple(_AXES), tuple(_STRAIGHT)),
    8: _with_diagonals(_STRAIGHT[:4], (0,)),
    26: _with_diagonals(_STRAIGHT, (0, 1, -1)),
}
"""The move sets by their number of moves: along the axes in the plane or in space (section 4.2), or diagonals as well."""


def usual_moves(grid: Grid) -> Moves:
    """The moves of the thesis: 4 on one height, 6 on several."""
    return MOVE_SETS[4 if grid.n_dimensions == 2 else 6]


@dataclass(frozen=True)
class Airspace:
    """Cells that may be entered, the moves between them, and what a forbidden move does.

    A move over the border of the grid has no cell to enter: it stays in place, or under `mask` is not offered. A diagonal move
    is forbidden as well where it would cut the corner of a blocked cell.
    """

    grid: Grid
    reason: NDArray[np.uint8]  # [n_cells] 0 = free, else 1 + the index in `reasons`
    reasons: tuple[Reason, ...] = (MARKED,)
    rule: Rule = USUAL_RULE
    moves: Moves = MOVE_SETS[4]

    @classmethod
    def of_blocked(
        cls, grid: Grid, blocked: NDArray[np.bool_], rule: Rule = USUAL_RULE, moves: Moves | None = None
    ) -> "Airspace":
        """The airspace of a mask `[n_cells]` of blocked cells, with the usual moves unless others are given."""
        return cls(grid, blocked.astype(np.uint8), rule=rule, moves=usual_moves(grid) if moves is None else moves)

    def __post_init__(self) -> None:
        if self.rule not in get_args(Rule):
            raise InputError(f"rule is {self.rule!r}; expected one of {', '.join(get_args(Rule))}")
        if self.reason.shape != (self.grid.n_cells,):
            raise InputError(f"reason has shape {self.reason.shape}; expected ({self.grid.n_cells},), one for each cell")
        if self.reason.size and int(self.reason.max()) > len(self.reasons):
            raise InputError(f"reason is {int(self.reason.max())} in a cell; expected at most {len(self.reasons)}")

    @cached_property
    def blocked(self) -> NDArray[np.bool_]:
        """Cells that may not be entered, `[n_cells]`."""
        return self.reason > 0

    @property
    def n_actions(self) -> int:
        """Number of moves."""
        return len(self.moves)

    @property
    def ends(self) -> bool:
        """Whether a flight can end in a blocked cell."""
        return self.rule == "end" and bool(self.blocked.any())

    def reason_of(self, cell: int) -> Reason | None:
        """Why the cell may not be entered; None for a free one."""
        code = int(self.reason[cell])
        return self.reasons[code - 1] if code else None

    def step(self, cell: ArrayLike, action: ArrayLike) -> tuple[IntArray, NDArray[np.uint8]]:
        """The cell after each action and what became of the move; `cell` and `action` broadcast."""
        cell, action = np.broadcast_arrays(np.asarray(cell, np.int32), np.asarray(action))
        here = self.grid.position(cell)
        offset = self.moves.array[action]
        inside, target = self._shifted(here, offset)
        forbidden = inside & self.blocked[target]
        if self.moves.diagonal:
            for kept in product((0, 1), repeat=3):
                on_the_way, corner = self._shifted(here, offset * np.array(kept, np.int32))
                forbidden |= inside & on_the_way & self.blocked[corner] & (corner != cell)
        event = np.where(inside, MOVED, MASKED if self.rule == "mask" else BORDER).astype(np.uint8)
        event[forbidden] = {"stay": STOPPED, "mask": MASKED, "end": ENTERED}[self.rule]
        if self.rule == "end" and self.moves.diagonal:
            event[forbidden & ~self.blocked[target]] = STOPPED  # a corner is in the way, but there is no cell to enter
        goes = (event == MOVED) | (event == ENTERED)
        return np.where(goes, target, cell).astype(np.int32), event

    def _shifted(self, here: IntArray, offset: IntArray) -> tuple[NDArray[np.bool_], IntArray]:
        """Whether each displaced position lies on the grid, and its cell; the first cell where it does not."""
        there = here + offset
        inside = np.asarray(((there >= 0) & (there < np.asarray(self.grid.sides))).all(-1))
        return inside, np.where(inside, self.grid.cell(there), 0).astype(np.int32)

    @cached_property
    def _tables(self) -> tuple[IntArray, NDArray[np.uint8]]:
        cells = np.arange(self.grid.n_cells, dtype=np.int32)
        moved = [self.step(cells, action) for action in range(self.n_actions)]
        return np.stack([cell for cell, _ in moved], axis=1), np.stack([event for _, event in moved], axis=1)

    @property
    def next_cell(self) -> IntArray:
        """Cell after each action, `[n_cells, n_actions]`."""
        return self._tables[0]

    @property
    def event(self) -> NDArray[np.uint8]:
        """What becomes of each action, `[n_cells, n_actions]`."""
        return self._tables[1]

    @cached_property
    def offered(self) -> NDArray[np.bool_]:
        """Actions that are offered, `[n_cells, n_actions]`; all of them unless the rule is `mask`."""
        return self.event != MASKED

    def flown(self) -> tuple[IntArray, IntArray, IntArray]:
        """All moves between free cells, as three arrays: from, to, action."""
        here, there, taken = [], [], []
        cells = np.flatnonzero(~self.blocked).astype(np.int32)
        for action in range(self.n_actions):
            target, event = self.step(cells, action)
            keep = event == MOVED
            here.append(cells[keep])
            there.append(target[keep])
            taken.append(np.full(int(keep.sum()), action, np.int8))
        return np.concatenate(here), np.concatenate(there), np.concatenate(taken)

    @cached_property
    def _links(self) -> csr_array:
        """Sparse adjacency of the free cells; every move has its opposite."""
        source, target, _ = self.flown()
        return csr_array((np.ones(source.size, np.float64), (source, target)), shape=(self.grid.n_cells,) * 2)

    @cached_property
    def part(self) -> IntArray:
        """Connected part of each cell, `[n_cells]`: equal numbers can reach each other; -1 in blocked cells."""
        labels = connected_components(self._links, directed=False)[1]
        return np.where(self.blocked, -1, labels).astype(np.int32)

    @cached_property
    def free_cells(self) -> IntArray:
        """Free cells that share their part with another one: every start and goal is drawn from these.

        `InputError` where there are none.
        """
        size = np.bincount(self.part[self.part >= 0], minlength=1)
        found = np.flatnonzero((self.part >= 0) & (size[np.maximum(self.part, 0)] > 1)).astype(np.int32)
        if not found.size:
            raise InputError("no connected pair of free cells: fly over more of the area or fill the map (`map.fill_radius_m`)")
        return found

    def shortest_steps(self, goals: IntArray) -> NDArray[np.float32]:
        """Moves on a shortest allowed path from every cell to each goal, `[n_cells, goals]`; inf where there is none."""
        if not self.blocked.any() and (self.moves.climbs or self.grid.n_dimensions == 2):
            here, there = self.grid.position(np.arange(self.grid.n_cells)), self.grid.position(goals)
            return self.moves.steps(there[None, :, :] - here[:, None, :]).astype(np.float32)
        return dijkstra(self._links, directed=False, indices=goals, unweighted=True).T.astype(np.float32)

    def start_goal_cells(self, start: Position | None = None, goal: Position | None = None) -> tuple[IntArray, IntArray]:
        """Cells a flight may start in and end in: all free cells, or the one given; `InputError` if it is unusable."""
        starts, goals = self.free_cells, self.free_cells
        if start is not None:
            starts = self._usable(start, "start")
        if goal is not None:
            goals = self._usable(goal, "goal")
        if start is not None and start == goal:
            raise InputError(f"start and goal are both {start}; choose two different cells")
        if not np.isin(self.part[starts], self.part[goals]).any():
            used = ", ".join(self.reasons[code - 1].name for code in np.unique(self.reason[self.blocked]))
            raise InputError(f"no route from {start} to {goal}: blocked cells cut them apart ({used})")
        return starts, goals

    def draw_pairs(self, rng: np.random.Generator, n: int, starts: IntArray, goals: IntArray) -> tuple[IntArray, IntArray]:
        """`n` starts and goals, uniform over all pairs of different cells that can reach each other, with replacement.

        `starts` and `goals` are the cells to draw from; at least one pair of them has to be connected.
        """
        s, g = np.empty(0, np.int32), np.empty(0, np.int32)
        while s.size < n:
            new_s, new_g = rng.choice(starts, 2 * n), rng.choice(goals, 2 * n)
            keep = (new_s != new_g) & (self.part[new_s] == self.part[new_g])
            s, g = np.concatenate([s, new_s[keep]]), np.concatenate([g, new_g[keep]])
        return s[:n], g[:n]

    def _usable(self, position: Position, what: str) -> IntArray:
        cell = self.grid.cell(self.grid.check_position(position, what))
        if np.isin(cell, self.free_cells):
            return cell.reshape(1)
        near = self.grid.position(self.free_cells[self.grid.manhattan(self.free_cells, cell).argmin()])
        free, reason = ",".join(str(i) for i in near), self.reason_of(int(cell))
        why = "is cut off from all other free cells" if reason is None else f"lies in a blocked cell ({reason})"
        raise InputError(f"the {what} {position} {why}: choose a free cell, the nearest is {free}")
