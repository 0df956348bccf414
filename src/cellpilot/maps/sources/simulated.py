"""Maps computed from a deployment: each bin is the mean of a fine lattice of simulated points."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor
from cellpilot.maps.limits import check_size
from cellpilot.maps.schema import RadioMap, make_map
from cellpilot.maps.sectors import NOISE_FIGURE, sectors_of
from cellpilot.maps.settings import AREA
from cellpilot.radio import Deployment, LosMode, Reception, simulate
from cellpilot.radio.settings import PROPAGATION

Range = tuple[float, float]

STRIP_POINTS = 2**17
"""Points simulated between two reports of progress."""

STRIP_LEVELS = 2**23
"""Points times sectors of which the received power is held at a time."""

MAX_RSRP_VALUES = 10_000_000
"""The received power of every sector is kept as long as sectors times cells are no more than these (40 MB)."""


def simulate_map(
    deployment: Deployment,
    *,
    environment: str = PROPAGATION.environment,
    los: LosMode = PROPAGATION.los,
    shadowing_seed: int | None = None,
    x_range_m: Range = AREA.x_range_m,
    y_range_m: Range = AREA.y_range_m,
    heights_m: Sequence[float] = AREA.heights_m,
    bin_m: float = AREA.bin_m,
    points_per_side: int = AREA.points_per_side,
    anchor: Anchor | None = None,
    names: Sequence[str] | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> RadioMap:
    """The RadioMap of a deployment over a rectangle [m], at each height [m, increasing].

    A bin's `sinr_db` is the mean of the dB values of points_per_side^2 points at the centres of a fine lattice within
    it, `sinr_spread_db` their standard deviation, `count` their number, `sinr_std_db` 0: nothing about a simulation
    is unknown. `serving_sector` is the one that serves most of the points, the lowest index on ties. The sites are
    kept as coordinates of the dimension `sector`, with their `names`. `progress` hears the share that is done.
    `environment`, `los`, `shadowing_seed` and the errors of the model's range: see `radio.simulate`. `InputError` for a
    rectangle that is no whole number of bins or heights that do not increase.
    """
    x_m, y_m = bin_centres("x", x_range_m, bin_m), bin_centres("y", y_range_m, bin_m)
    z_m = _heights(heights_m)
    check_size((x_m.size, y_m.size, z_m.size))
    if points_per_side < 1:
        raise InputError(f"points_per_side is {points_per_side}; expected at least 1")
    offset_m = ((np.arange(points_per_side) + 0.5) / points_per_side - 0.5) * bin_m
    bins = _Bins.empty((z_m.size, y_m.size, x_m.size), deployment.n_sectors)
    # Some rows of bins at a time bound the memory; all heights together, because they share what lies below them.
    points = min(STRIP_POINTS, STRIP_LEVELS // deployment.n_sectors) if bins.rsrp_dbm is not None else STRIP_POINTS
    rows = max(1, points // (x_m.size * z_m.size * points_per_side**2))
    for first in range(0, y_m.size, rows):
        strip = slice(first, min(first + rows, y_m.size))
        reception = simulate(
            deployment,
            (x_m[:, None] + offset_m)[None, None, :, None, :],
            (y_m[strip, None] + offset_m)[None, :, None, :, None],
            z_m[:, None, None, None, None],
            environment=environment,
            los=los,
            shadowing_seed=shadowing_seed,
            every_sector=bins.rsrp_dbm is not None,
        )
        bins.fill(strip, reception)
        progress(strip.stop / y_m.size)
    return make_map(
        bins.mean_db,
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        count=points_per_side**2,
        optional=bins.optional(),
        sectors=sectors_of(deployment, names),
        anchor=anchor,
        source="simulation",
        model=f"{environment}, LOS {los}, {'no shadowing' if shadowing_seed is None else 'correlated shadowing'}",
        seed=shadowing_seed,
        attributes={
            "environment": environment,
            "los": los,
            "bin_m": float(bin_m),
            "points_per_side": points_per_side,
            NOISE_FIGURE: float(deployment.noise_figure_db),
        },
    )


@dataclass(frozen=True, eq=False)
class _Bins:
    """What the points of each bin say together, `[z, y, x]`."""

    mean_db: FloatArray
    spread_db: FloatArray  # NaN where there is one point
    serving: NDArray[np.int32]
    rsrp_dbm: NDArray[np.float32] | None  # [sector, z, y, x]

    @classmethod
    def empty(cls, shape: tuple[int, int, int], n_sectors: int) -> "_Bins":
        kept = n_sectors * np.prod(shape) <= MAX_RSRP_VALUES
        rsrp_dbm = np.empty((n_sectors, *shape), np.float32) if kept else None
        return cls(np.empty(shape), np.full(shape, np.nan), np.empty(shape, np.int32), rsrp_dbm)

    def fill(self, strip: slice, reception: Reception) -> None:
        """Take in the points of some rows, `[z, y, x, point in y, point in x]`."""
        sinr_db = reception.sinr_db.reshape(*reception.sinr_db.shape[:3], -1)
        self.mean_db[:, strip] = sinr_db.mean(axis=-1)
        if sinr_db.shape[-1] > 1:
            self.spread_db[:, strip] = sinr_db.std(axis=-1, ddof=1)
        self.serving[:, strip] = _most_frequent(reception.serving_sector.reshape(sinr_db.shape))
        if self.rsrp_dbm is not None and reception.sector_rsrp_dbm is not None:
            self.rsrp_dbm[:, :, strip] = reception.sector_rsrp_dbm.reshape(-1, *sinr_db.shape).mean(axis=-1)

    def optional(self) -> dict[str, NDArray[np.generic]]:
        """Variables that a map may have."""
        found: dict[str, NDArray[np.generic]] = {"sinr_spread_db": self.spread_db, "serving_sector": self.serving}
        return found if self.rsrp_dbm is None else found | {"rsrp_dbm": self.rsrp_dbm}


def bin_centres(axis: str, range_m: Range, bin_m: float) -> FloatArray:
    low_m, high_m = range_m
    if not np.isfinite([low_m, high_m, bin_m]).all() or bin_m <= 0 or high_m <= low_m:
        raise InputError(
            f"{axis} runs from {low_m:g} to {high_m:g} m in bins of {bin_m:g} m; expected rising limits and a positive bin"
        )
    span_m = high_m - low_m
    bins = span_m / bin_m
    if round(bins) < 1 or abs(bins - round(bins)) > 1e-6:
        raise InputError(f"{axis} spans {span_m:g} m, which is {bins:.4g} bins of {bin_m:g} m; expected a whole number")
    return np.asarray(low_m + (np.arange(round(bins)) + 0.5) * bin_m)


def _heights(heights_m: Sequence[float]) -> FloatArray:
    z_m = np.atleast_1d(np.asarray(heights_m, dtype=np.float64))
    if not z_m.size or not np.isfinite(z_m).all() or (np.diff(z_m) <= 0).any():
        raise InputError(f"the heights are {', '.join(f'{z:g}' for z in z_m) or 'none'} m; expected at least one, increasing")
    return z_m


def _most_frequent(sector: NDArray[np.int64]) -> NDArray[np.int64]:
    """The most frequent value along the last axis, the lowest on ties."""
    if sector.shape[-1] == 1:
        return sector[..., 0]
    places = np.sort(sector.reshape(-1, sector.shape[-1]), axis=-1)
    # Equal values stand side by side: the first end of the longest run is the answer.
    index = np.arange(places.shape[-1])
    begins = np.concatenate([np.ones((len(places), 1), bool), places[:, 1:] != places[:, :-1]], axis=-1)
    run = index - np.maximum.accumulate(np.where(begins, index, 0), axis=-1)
    return np.take_along_axis(places, run.argmax(axis=-1)[:, None], axis=-1)[:, 0].reshape(sector.shape[:-1])
