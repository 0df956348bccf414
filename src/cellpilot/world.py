"""`World`: the facts of one place, as arrays over cells. No JAX here; `envs` registers it as a pytree."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.special import ndtr

from cellpilot.errors import InputError
from cellpilot.grid import Grid, IntArray, Position

if TYPE_CHECKING:
    from xarray import Dataset


UNHEARD_DBM = -156.0
"""Lowest RSRP that a receiver reports [dBm]: 3GPP TS 36.133 clause 9.1.4. At or below it nothing is heard of a sector."""


@dataclass(frozen=True)
class SectorLevels:
    """What a drone would measure of every sector, `[sector, n_cells]`."""

    rsrp_dbm: NDArray[np.float32]  # -156 where nothing is heard of it
    sinr_db: NDArray[np.float32]  # if that sector served


@dataclass(frozen=True)
class World:
    """What is true of every cell of a grid, in the order of `Grid.cell`.

    Unknown SINR in a blocked cell is NaN; a free cell always has a value. SINR is float32 here and everywhere
    below, so that compiled and plain code compare the same number with the threshold.
    """

    grid: Grid
    sinr_db: NDArray[np.float32]  # [n_cells] mean SINR
    sinr_std_db: NDArray[np.float32]  # [n_cells] what is not known about the map: drawn once per world
    noise_std_db: float  # drawn anew at every step
    blocked: NDArray[np.bool_]  # [n_cells]
    serving_sector: IntArray | None = None  # [n_cells] index of the serving sector, -1 where unknown
    levels: SectorLevels | None = None  # where the map knows every sector

    @classmethod
    def from_map(cls, radio_map: "Dataset", noise_std_db: float = 0.0) -> "World":
        """The world of a `RadioMap`; a free cell of unknown SINR (`unknown = "bad"`) counts as below any threshold."""
        from cellpilot.maps.sectors import sector_levels

        grid = Grid(*(tuple(float(v) for v in radio_map[axis].values) for axis in "xyz"))
        blocked = radio_map["blocked"].values.ravel()
        sinr_db = radio_map["sinr_db"].values.ravel().astype(np.float32)
        std_db = np.nan_to_num(radio_map["sinr_std_db"].values.ravel()).astype(np.float32)
        serving = radio_map["serving_sector"].values.ravel().astype(np.int32) if "serving_sector" in radio_map else None
        known = sector_levels(radio_map)
        levels = None
        if known is not None:
            rsrp_dbm = np.nan_to_num(known[0], nan=UNHEARD_DBM, neginf=UNHEARD_DBM).clip(UNHEARD_DBM)
            levels = SectorLevels(rsrp_dbm.astype(np.float32), known[1].astype(np.float32))
        sinr_db = np.where(np.isnan(sinr_db) & ~blocked, -np.inf, sinr_db)
        return cls(grid, sinr_db, std_db, noise_std_db, blocked, serving, levels)

    def __post_init__(self) -> None:
        if not np.isfinite(self.noise_std_db) or self.noise_std_db < 0:
            raise InputError(f"noise_std_db is {self.noise_std_db:g}; expected a finite value >= 0 dB")
        if np.isnan(self.sinr_db[~self.blocked]).any():
            raise InputError("a free cell has no SINR: fill the map or block its unknown cells")
        if not self.free_cells.size:
            raise InputError("no connected pair of free cells: fly over more of the area or fill the map (--map.fill-radius-m)")

    @cached_property
    def _moves(self) -> tuple[IntArray, NDArray[np.bool_]]:
        return self.grid.next_cells(self.blocked)

    @property
    def next_cell(self) -> IntArray:
        """Cell after each action, `[n_cells, n_actions]`."""
        return self._moves[0]

    @property
    def stopped(self) -> NDArray[np.bool_]:
        """Whether a blocked cell stops the action, `[n_cells, n_actions]`."""
        return self._moves[1]

    @cached_property
    def _links(self) -> csr_array:
        """Sparse adjacency of the free cells."""
        source = np.repeat(np.arange(self.grid.n_cells), self.grid.n_actions)
        target = self.next_cell.ravel()
        keep = ~self.blocked[source] & (source != target)
        return coo_array((np.ones(keep.sum()), (source[keep], target[keep])), shape=(self.grid.n_cells,) * 2).tocsr()

    @cached_property
    def part(self) -> IntArray:
        """Connected part of each cell, `[n_cells]`: equal numbers can reach each other; -1 in blocked cells."""
        labels = connected_components(self._links, directed=False)[1]
        return np.where(self.blocked, -1, labels).astype(np.int32)

    @cached_property
    def free_cells(self) -> IntArray:
        """Free cells that share their part with another one: every start and goal is drawn from these."""
        size = np.bincount(self.part[self.part >= 0], minlength=1)
        usable = (self.part >= 0) & (size[np.maximum(self.part, 0)] > 1)
        return np.flatnonzero(usable).astype(np.int32)

    def shortest_steps(self, goals: IntArray) -> NDArray[np.float32]:
        """Moves on a shortest allowed path from every cell to each goal, `[n_cells, goals]`; inf where there is none."""
        if not self.blocked.any():
            return self.grid.manhattan(np.arange(self.grid.n_cells)[:, None], goals[None, :]).astype(np.float32)
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
            raise InputError(f"no route from {start} to {goal}: blocked cells cut them apart")
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
        if not np.isin(cell, self.free_cells):
            near = self.grid.position(self.free_cells[self.grid.manhattan(self.free_cells, cell).argmin()])
            free = ",".join(str(i) for i in near)
            raise InputError(f"the {what} {position} is blocked or cut off: choose a free cell, the nearest is {free}")
        return cell.reshape(1)

    def low_probability(self, threshold_db: float) -> NDArray[np.float64]:
        """Chance `[n_cells]` that one measurement in the cell falls below the threshold.

        Q((sinr - threshold) / sqrt(noise^2 + map uncertainty^2)); 0 or 1 where both are zero; NaN in blocked cells
        of unknown SINR.
        """
        # Subtracted as float32, so that a cell on the threshold falls on the same side as in the environment.
        margin_db = (self.sinr_db - np.float32(threshold_db)).astype(np.float64)
        spread_db = np.hypot(self.noise_std_db, self.sinr_std_db.astype(np.float64))
        certain = spread_db == 0
        chance = np.where(certain, (margin_db < 0).astype(float), ndtr(-margin_db / np.where(certain, 1.0, spread_db)))
        return np.where(np.isnan(margin_db), np.nan, chance)
