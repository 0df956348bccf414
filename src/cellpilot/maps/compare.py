"""Two maps of one grid beside each other."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.geodesy import to_local
from cellpilot.maps.schema import RadioMap, anchor_of


class Comparison(NamedTuple):
    """How map B differs from map A at one height, or at all of them, in cells known in both."""

    height: str
    cells: int
    mean_db: float  # B less A
    rms_db: float
    correlation: float
    agreement: float  # share of cells on the same side of the threshold


def compared(a: RadioMap, b: RadioMap, threshold_db: float, name_a: str = "A", name_b: str = "B") -> list[Comparison]:
    """One comparison for each height and one for all; `InputError` naming the axis in which the grids differ."""
    check_one_grid(a, b, name_a, name_b)
    first, second = (each["sinr_db"].values.astype(np.float64) for each in (a, b))
    rows = [_row(f"{z_m:g}", first[iz], second[iz], threshold_db) for iz, z_m in enumerate(a["z"].values)]
    return [*rows, _row("all", first, second, threshold_db)] if len(rows) > 1 else rows


def check_one_grid(a: RadioMap, b: RadioMap, name_a: str, name_b: str) -> None:
    """`InputError` unless both maps have the same cell centres, to a millimetre, and the same anchor, if both have one."""
    here, there = anchor_of(a), anchor_of(b)
    if here is not None and there is not None:
        x_m, y_m = to_local(here.latitude_deg, here.longitude_deg, there)
        if np.hypot(x_m, y_m) > 1e-3:
            raise InputError(
                f"the grids differ: x = y = 0 lies {np.hypot(x_m, y_m):,.3f} m apart in {name_a} and {name_b};"
                " expected the same cells: simulate or import one map with the other's anchor"
            )
    for axis in "xyz":
        left, right = a[axis].values, b[axis].values
        if left.shape != right.shape or np.abs(left - right).max() > 1e-3:
            spans = [f"{len(v)} from {v[0]:g} to {v[-1]:g} m" for v in (left, right)]
            raise InputError(
                f"the grids differ: {axis} has {spans[0]} in {name_a} and {spans[1]} in {name_b};"
                " expected the same cells: simulate or import one map with the other's area and bins"
            )


def _row(height: str, a: NDArray[np.float64], b: NDArray[np.float64], threshold_db: float) -> Comparison:
    both = np.isfinite(a) & np.isfinite(b)
    a, b = a[both], b[both]
    if not a.size:
        return Comparison(height, 0, np.nan, np.nan, np.nan, np.nan)
    flat = a.std() == 0 or b.std() == 0
    correlation = np.nan if flat else float(np.corrcoef(a, b)[0, 1])
    agreement = float(((a < threshold_db) == (b < threshold_db)).mean())
    return Comparison(height, a.size, float((b - a).mean()), float(np.sqrt(np.mean((b - a) ** 2))), correlation, agreement)
