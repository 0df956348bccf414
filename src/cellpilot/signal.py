"""`Signal`: what a drone would measure in each cell. Nothing here depends on where one may fly.

Two spreads, never mixed: noise is drawn at every step; what is unknown of the map is drawn once per world, and hangs together
over the distance that its source states. NumPy only; `measure` and `Unknown.draw` use arithmetic that traced arrays share.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.reasons import blocked_cells

if TYPE_CHECKING:
    from xarray import Dataset

UNHEARD_DBM = -156.0
"""Lowest RSRP that a receiver reports [dBm]: 3GPP TS 36.133 clause 9.1.4. At or below it nothing is heard of a sector."""

CORRELATION_M = 50.0
"""Distance over which the error of a map falls to 1/e where its source states none [m]: the correlation distance of shadow
fading without line of sight in a city (3GPP TR 38.901 Table 7.5-6, UMa NLOS)."""


@dataclass(frozen=True)
class SectorLevels:
    """What a drone would measure of every sector, `[sector, n_cells]`."""

    rsrp_dbm: NDArray[np.float32]  # -156 where nothing is heard of it
    sinr_db: NDArray[np.float32]  # if that sector served


@dataclass(frozen=True)
class Unknown:
    """What is not known of a map: a standard deviation for each cell, and how the errors of cells hang together.

    The error of the map is `std_db` times a normal field of variance 1 whose correlation is the product over the axes of
    exp(-distance / `correlation_m`). A map drawn with it is one that may be the true one.
    """

    std_db: Any  # [n_cells] float32
    along_x: Any  # [nx, nx] lower factor of the correlation along each axis
    along_y: Any
    along_z: Any

    @classmethod
    def of(cls, grid: Grid, std_db: NDArray[np.float32], correlation_m: float) -> "Unknown | None":
        """Of a grid; None where everything is known. `InputError` unless `correlation_m` is 0 (each cell for itself) or more."""
        if not np.isfinite(correlation_m) or correlation_m < 0:
            raise InputError(f"sinr_correlation_m is {correlation_m:g}; expected a finite distance of 0 m or more")
        if not std_db.any():
            return None
        return cls(std_db.astype(np.float32), *(_factor(axis_m, correlation_m) for axis_m in (grid.x_m, grid.y_m, grid.z_m)))

    def draw(self, normal: Any) -> Any:
        """Errors of whole maps [dB], `[..., n_cells]`, from as many independent standard normal numbers."""
        shape = (*normal.shape[:-1], len(self.along_z), len(self.along_y), len(self.along_x))
        field = normal.reshape(shape) @ self.along_x.T
        field = (field.swapaxes(-1, -2) @ self.along_y.T).swapaxes(-1, -2)
        field = (field.swapaxes(-1, -3) @ self.along_z.T).swapaxes(-1, -3)
        return self.std_db * field.reshape(normal.shape)


def _factor(axis_m: tuple[float, ...], correlation_m: float) -> NDArray[np.float32]:
    """Lower triangular factor of exp(-distance / correlation) along an axis: a first-order autoregression, so it is exact."""
    n = len(axis_m)
    if not correlation_m:
        return np.eye(n, dtype=np.float32)
    kept = np.exp(-np.diff(np.asarray(axis_m, np.float64)) / correlation_m)
    factor = np.zeros((n, n))
    factor[0, 0] = 1.0
    for i in range(1, n):
        factor[i] = kept[i - 1] * factor[i - 1]
        factor[i, i] = np.sqrt(1.0 - kept[i - 1] ** 2)
    return factor.astype(np.float32)


NO_NOISE_DB = 0.0
"""Unless somebody asks for noise, a measurement is what the map says."""


@dataclass(frozen=True)
class Signal:
    """Mean SINR in every cell, what is unknown of it, and the noise of one measurement.

    SINR is float32 here and everywhere below, so that compiled and plain code compare the same number with the threshold.
    """

    mean_db: Any  # [n_cells] float32; NaN where it is unknown, -inf where it counts as below any threshold
    noise_std_db: Any = NO_NOISE_DB  # of a measurement, drawn at every step
    unknown: Unknown | None = None
    serving_sector: NDArray[np.int32] | None = None  # [n_cells], -1 where unknown
    levels: SectorLevels | None = None  # where the map knows every sector

    @classmethod
    def from_map(cls, radio_map: "Dataset", grid: Grid, noise_std_db: float = NO_NOISE_DB) -> "Signal":
        """The signal of a `RadioMap`; a free cell of unknown SINR (`unknown = "bad"`) counts as below any threshold."""
        from cellpilot.maps.sectors import sector_levels

        check_noise(noise_std_db)
        blocked = blocked_cells(radio_map).ravel()
        mean_db = radio_map["sinr_db"].values.ravel().astype(np.float32)
        std_db = np.nan_to_num(radio_map["sinr_std_db"].values.ravel()).astype(np.float32)
        serving = radio_map["serving_sector"].values.ravel().astype(np.int32) if "serving_sector" in radio_map else None
        known = sector_levels(radio_map)
        levels = None
        if known is not None:
            rsrp_dbm = np.nan_to_num(known[0], nan=UNHEARD_DBM, neginf=UNHEARD_DBM).clip(UNHEARD_DBM)
            levels = SectorLevels(rsrp_dbm.astype(np.float32), known[1].astype(np.float32))
        mean_db = np.where(np.isnan(mean_db) & ~blocked, np.float32(-np.inf), mean_db)
        correlation_m = float(radio_map.attrs.get("sinr_correlation_m", CORRELATION_M))
        return cls(mean_db, noise_std_db, Unknown.of(grid, std_db, correlation_m), serving, levels)

    @property
    def std_db(self) -> NDArray[np.float32]:
        """What is unknown of the map, for each cell by itself: `[n_cells]` standard deviation."""
        return np.zeros(self.mean_db.shape, np.float32) if self.unknown is None else np.asarray(self.unknown.std_db)

    def measure(self, cell: Any, error_db: Any = None, noise: Any = None) -> Any:
        """SINR as measured in each cell `[...]` [dB, float32]: mean, error of the map there, and noise.

        `error_db [...]` is taken from a map that `unknown.draw` made; `noise [...]` are standard normal numbers.
        """
        sinr_db = self.mean_db[cell]
        if error_db is not None:
            sinr_db = sinr_db + error_db
        if noise is not None:
            sinr_db = sinr_db + self.noise_std_db * noise
        return sinr_db

    def outage_probability(self, threshold_db: float) -> NDArray[np.float64]:
        """Chance `[n_cells]` that one measurement in the cell falls below the threshold.

        Q((sinr - threshold) / sqrt(noise^2 + map uncertainty^2)); 0 or 1 where both are zero; NaN where SINR is NaN.
        """
        # Subtracted as float32, so that a cell on the threshold falls on the same side as in the environment.
        margin_db = (self.mean_db - np.float32(threshold_db)).astype(np.float64)
        spread_db = np.hypot(self.noise_std_db, self.std_db.astype(np.float64))
        certain = spread_db == 0
        chance = np.where(certain, (margin_db < 0).astype(float), ndtr(-margin_db / np.where(certain, 1.0, spread_db)))
        return np.where(np.isnan(margin_db), np.nan, chance)


def check_noise(noise_std_db: float) -> None:
    """`InputError` unless it is a finite standard deviation."""
    if not np.isfinite(noise_std_db) or noise_std_db < 0:
        raise InputError(f"noise_std_db is {noise_std_db:g}; expected a finite value >= 0 dB")
