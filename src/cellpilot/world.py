"""`World`: one place, which is where one may fly (`Airspace`) and what one would measure there (`Signal`)."""

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import MOVE_SETS, USUAL_RULE, Airspace, Rule, usual_moves
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.reasons import reasons_of
from cellpilot.signal import NO_NOISE_DB, Signal, check_noise

if TYPE_CHECKING:
    from xarray import Dataset


@dataclass(frozen=True)
class World:
    """Airspace and signal of the same cells, in the order of `Grid.cell`; a free cell always has a SINR."""

    airspace: Airspace
    signal: Signal

    @classmethod
    def from_map(
        cls, radio_map: "Dataset", noise_std_db: float = NO_NOISE_DB, rule: Rule = USUAL_RULE, n_moves: int | None = None
    ) -> "World":
        """The world of a `RadioMap`; `n_moves` names a move set (None = 4 on one height, 6 on several)."""
        grid = Grid(*(tuple(float(v) for v in radio_map[axis].values) for axis in "xyz"))
        moves = usual_moves(grid) if n_moves is None else MOVE_SETS[n_moves]
        airspace = Airspace(grid, radio_map["blocked_reason"].values.ravel(), reasons_of(radio_map), rule, moves)
        return cls(airspace, Signal.from_map(radio_map, grid, noise_std_db))

    def __post_init__(self) -> None:
        check_noise(self.signal.noise_std_db)
        if np.isnan(self.signal.mean_db[~self.airspace.blocked]).any():
            raise InputError("a free cell has no SINR: fill the map or block its unknown cells")

    @property
    def grid(self) -> Grid:
        """The grid of both."""
        return self.airspace.grid

    @cached_property
    def _outages(self) -> dict[float, NDArray[np.float64]]:
        return {}

    def outage_probability(self, threshold_db: float) -> NDArray[np.float64]:
        """Chance `[n_cells]` that a measurement is below the threshold; a blocked cell of unknown SINR counts as not below."""
        if threshold_db not in self._outages:
            chance = np.nan_to_num(self.signal.outage_probability(threshold_db))
            chance.flags.writeable = False
            self._outages[threshold_db] = chance
        return self._outages[threshold_db]
