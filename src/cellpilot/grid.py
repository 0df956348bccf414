"""The grid: positions, cells and metres.

A *position* is the triple `(ix, iy, iz)`; a *cell* is the same place as one integer, counted through `(z, y, x)`
as a dataset is laid out. Nothing outside this file translates between the two.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.errors import InputError

IntArray = NDArray[np.signedinteger]
Position = tuple[int, int, int]


@dataclass(frozen=True)
class Grid:
    """Cell centres along each axis [m, local, increasing]: x east, y north, z up."""

    x_m: tuple[float, ...]
    y_m: tuple[float, ...]
    z_m: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.n_cells < 2:
            raise InputError(f"the grid has {self.n_cells} cell(s); a flight needs at least 2: use a larger area or smaller bins")

    @cached_property
    def sides(self) -> Position:
        """Number of cells along x, y and z."""
        return len(self.x_m), len(self.y_m), len(self.z_m)

    @property
    def n_cells(self) -> int:
        """Number of cells in all."""
        nx, ny, nz = self.sides
        return nx * ny * nz

    @property
    def n_dimensions(self) -> int:
        """2 for one height, 3 for several."""
        return 2 if len(self.z_m) == 1 else 3

    def cell(self, position: ArrayLike) -> IntArray:
        """Cell numbers of positions `[..., 3]`."""
        nx, ny, _ = self.sides
        ix, iy, iz = np.moveaxis(np.asarray(position), -1, 0)
        return np.asarray((iz * ny + iy) * nx + ix, dtype=np.int32)

    def position(self, cell: ArrayLike) -> IntArray:
        """Positions `[..., 3]` of cell numbers."""
        nx, ny, _ = self.sides
        cell = np.asarray(cell)
        return np.stack([cell % nx, cell // nx % ny, cell // (nx * ny)], axis=-1).astype(np.int32)

    def metres(self, cell: ArrayLike) -> NDArray[np.float64]:
        """Centres `[..., 3]` of cells as (x, y, z) [m]."""
        ix, iy, iz = np.moveaxis(self.position(cell), -1, 0)
        return np.stack([np.asarray(self.x_m)[ix], np.asarray(self.y_m)[iy], np.asarray(self.z_m)[iz]], axis=-1)

    def nearest_position(self, point_m: tuple[float, float, float]) -> Position:
        """Position of the cell that contains the point `(x, y, z)` [m]; `InputError` outside the map.

        On a map of one height, any altitude is flown at that height."""
        found = []
        for name, value, centres in zip("xyz", point_m, (self.x_m, self.y_m, self.z_m), strict=True):
            edges = _edges(centres, self._step_m if name != "z" else np.inf)
            if not edges[0] <= value <= edges[-1]:
                raise InputError(f"{name} = {value:g} m lies outside the map ({edges[0]:g} to {edges[-1]:g} m)")
            found.append(min(int(np.searchsorted(edges, value, side="right")) - 1, len(centres) - 1))
        return found[0], found[1], found[2]

    @property
    def _step_m(self) -> float:
        """Side of a cell in the plane [m]; infinite on a grid of one column, which has no other measure."""
        steps = [axis[1] - axis[0] for axis in (self.x_m, self.y_m) if len(axis) > 1]
        return min(steps, default=np.inf)

    def check_position(self, position: tuple[int, ...], what: str) -> Position:
        """The position itself if it lies on the grid, else `InputError` naming `what`."""
        if len(position) != 3 or any(not 0 <= i < n for i, n in zip(position, self.sides, strict=True)):
            ranges = ", ".join(f"{axis} 0..{n - 1}" for axis, n in zip(("ix", "iy", "iz"), self.sides, strict=True))
            raise InputError(f"{what} {position} is not on the grid: expected {ranges}")
        return position[0], position[1], position[2]

    def manhattan(self, cell: ArrayLike, goal: ArrayLike) -> IntArray:
        """Sum of the differences of the coordinates of two cells."""
        return np.abs(self.position(cell) - self.position(goal)).sum(-1).astype(np.int32)


def _edges(centres_m: tuple[float, ...], step_m: float) -> NDArray[np.float64]:
    """Borders of the cells along an axis [m]: half-way between centres; a single cell is `step_m` wide."""
    centres = np.asarray(centres_m)
    if centres.size == 1:
        return np.array([centres[0] - step_m / 2, centres[0] + step_m / 2])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[2 * centres[0] - middle[0]], middle, [2 * centres[-1] - middle[-1]]])
