"""`Signal`: what a drone would measure in each cell. Nothing here depends on where one may fly.

Two spreads, never mixed: noise is drawn at every step; what is unknown of the map is drawn once per world, and hangs together
as the estimate of the map says. NumPy only; `measure` and `Unknown.draw` use arithmetic that traced arrays share.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.maps.estimate.correlation import (
    CORRELATION_M,
    Field,
    Measured,
    along_axes,
    axis_factors,
    shared_rows,
    transposed,
)
from cellpilot.maps.reasons import blocked_cells

if TYPE_CHECKING:
    from xarray import Dataset

UNHEARD_DBM = -156.0
"""Lowest RSRP that a receiver reports [dBm]: 3GPP TS 36.133 clause 9.1.4. At or below it nothing is heard of a sector."""

MOST_SHARED = 1.0 - 1e-4
"""Largest share of a cell's variance that is common to all cells: a little stays its own, so that the rest has a factor."""


@dataclass(frozen=True)
class SectorLevels:
    """What a drone would measure of every sector, `[sector, n_cells]`."""

    rsrp_dbm: NDArray[np.float32]  # -156 where nothing is heard of it
    sinr_db: NDArray[np.float32]  # if that sector served


@dataclass(frozen=True)
class Unknown:
    """What is not known of a map: a standard deviation for each cell, and how the errors of cells hang together.

    A map drawn with it is one that may be the true one. The error of the map is a normal field: one part common to all cells,
    and a rest whose correlation is the product over the axes of exp(-distance / length); or the posterior of a Gaussian process.
    """

    std_db: Any  # [n_cells] float32
    along_x: Any  # [nx, nx] lower factor of the correlation along each axis
    along_y: Any
    along_z: Any
    scale_db: Any  # [n_cells] what the field is multiplied with, so that its standard deviation is `std_db`
    shared: Any = None  # [terms, n_cells] see `shared_rows`; None where nothing is common to all cells
    measured: Any = None  # `Measured` cells that the field is conditioned on; None where there are none

    @classmethod
    def of(cls, grid: Grid, std_db: NDArray[np.float32], correlation_m: float, common_std_db: float = 0.0) -> "Unknown | None":
        """Of a grid, with one error common to all cells; None where everything is known.

        In a cell whose standard deviation is smaller than the common one, (nearly) all of it is common. `InputError` unless
        `correlation_m` is 0 (each cell for itself) or more, and `common_std_db` too.
        """
        for name, value, unit in (("sinr_correlation_m", correlation_m, "m"), ("sinr_common_std_db", common_std_db, "dB")):
            if not np.isfinite(value) or value < 0:
                raise InputError(f"{name} is {value:g}; expected a finite value of 0 {unit} or more")
        if not std_db.any():
            return None
        factors = axis_factors(grid, (correlation_m,) * 3)
        certain = std_db == 0
        ratio = np.where(certain, 0.0, common_std_db) / np.where(certain, 1.0, std_db)
        share = np.minimum(np.minimum(ratio, 1.0) ** 2, MOST_SHARED)
        shared = shared_rows(factors, np.sqrt(share / (1.0 - share))[None]) if share.any() else None
        return cls._of_field(std_db, Field(factors, 1.0 / np.sqrt(1.0 - share), shared, None))

    @classmethod
    def of_map(cls, radio_map: "Dataset", grid: Grid, std_db: NDArray[np.float32]) -> "Unknown | None":
        """As the attributes of a `RadioMap` state it: from the posterior of a Gaussian process, unless an error is common."""
        from cellpilot.maps.estimate.fill import is_measured
        from cellpilot.maps.estimate.posterior import parsed_kernel, posterior

        defaults = (("sinr_correlation_m", CORRELATION_M), ("sinr_common_std_db", 0.0))
        correlation_m, common_std_db = (float(radio_map.attrs.get(*default)) for default in defaults)
        if "fill_kernel" not in radio_map.attrs or common_std_db or not std_db.any():
            return cls.of(grid, std_db, correlation_m, common_std_db)
        cells = np.flatnonzero(is_measured(radio_map))
        count = np.maximum(radio_map["count"].values.ravel()[cells], 1).astype(np.float64)
        return cls._of_field(std_db, posterior(grid, parsed_kernel(radio_map.attrs["fill_kernel"]), cells, count))

    @classmethod
    def _of_field(cls, std_db: NDArray[np.float32], field: Field) -> "Unknown":
        """With the types of compiled code, and the standard deviation of each cell whatever that of the field is."""
        x, y, z, scale_db = (np.asarray(values, np.float32) for values in (*field.factors, std_db / field.std))
        shared = None if field.shared is None else field.shared.astype(np.float32)
        measured = field.measured
        if measured is not None:
            cells, number = (index.astype(np.int32) for index in (measured.cells, measured.number))
            measured = Measured(cells, number, measured.gain.astype(np.float32))
        return cls(std_db.astype(np.float32), x, y, z, scale_db, shared, measured)

    def draw(self, normal: Any) -> Any:
        """Errors of whole maps [dB], `[..., n_cells]`, from as many independent standard normal numbers."""
        factors = (self.along_x, self.along_y, self.along_z)
        field = along_axes(self._with_shared(normal), factors)
        if self.measured is not None:
            weights = (field[..., self.measured.cells] @ self.measured.gain.T)[..., self.measured.number]
            drawn = self._with_shared(along_axes(weights, transposed(factors)))
            field = field - along_axes(self._with_shared(drawn), factors)
        return self.scale_db * field

    def _with_shared(self, normal: Any) -> Any:
        return normal if self.shared is None else normal + (normal @ self.shared.T) @ self.shared


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
        return cls(mean_db, noise_std_db, Unknown.of_map(radio_map, grid, std_db), serving, levels)

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
