"""How large a map may be, asked before anything is allocated, and which values no network has."""

from typing import NamedTuple

import numpy as np

from cellpilot.errors import InputError

MAX_CELLS = 10_000_000
"""Cells of a map that is simulated or read. More means a stray position, a cell far too small, or a damaged header."""


def check_size(sides: tuple[int, ...], what: str = "the map") -> None:
    """`InputError` with both figures if a grid of these sides has more than `MAX_CELLS` cells."""
    cells = 1
    for side in sides:  # of Python's own integers, which do not overflow
        cells *= int(side)
    if cells > MAX_CELLS:
        raise InputError(
            f"{what} would have {cells:,} cells; at most {MAX_CELLS:,} are read or made: use larger bins or a smaller area"
        )


class ValueRange(NamedTuple):
    """Values that a variable of a map can have."""

    low: float
    high: float
    reason: str


RANGES = {
    "sinr_db": ValueRange(-1000.0, 1000.0, "beyond what any receiver measures"),
    "sinr_std_db": ValueRange(0.0, 300.0, "an uncertainty"),
    "rsrp_dbm": ValueRange(-1000.0, 200.0, "beyond what any transmitter sends"),
    "sector_power_dbm": ValueRange(-200.0, 200.0, "beyond what any transmitter sends"),
    "sector_carrier_hz": ValueRange(1e6, 1e12, "no radio frequency"),
    "sector_bandwidth_hz": ValueRange(1.0, 1e11, "no channel bandwidth"),
    "sector_load": ValueRange(0.0, 1.0, "a share of the carrier"),
    "x": ValueRange(-1e7, 1e7, "farther than the Earth is round"),
    "y": ValueRange(-1e7, 1e7, "farther than the Earth is round"),
    "z": ValueRange(-1e5, 1e5, "beyond the atmosphere"),
}
"""Wide: they find damaged files and exchanged units, not unlikely networks."""


def check_values(name: str, values: np.ndarray, where: str) -> None:
    """`InputError` if a variable holds a value that it cannot have; NaN stands for unknown where the schema allows it."""
    limits = RANGES.get(name)
    if limits is None or not values.size:
        return
    with np.errstate(invalid="ignore"):
        outside = (values < limits.low) | (values > limits.high)
    if outside.any():
        found = float(values[outside][0])
        raise InputError(
            f"{where}: {name} holds {found:g} ({limits.reason}); expected {limits.low:g} to {limits.high:g}: correct the file"
        )
