"""Where the transmitters stand and what they send."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.errors import InputError
from cellpilot.radio.antenna import Antenna, ColumnAntenna
from cellpilot.radio.interference import Interference, check_bandwidths
from cellpilot.radio.propagation import check_carrier, check_heights
from cellpilot.radio.ranges import FloatArray, as_floats, check_range
from cellpilot.radio.settings import HEXAGONAL


@dataclass(frozen=True, eq=False)
class Deployment:
    """Sectors and what they send. Every array is `[sector]`; a single number or antenna stands for all sectors.

    Sectors interfere as far as their occupied bands overlap: fully on the same carrier, not at all on separate ones.

    `RangeError` for heights outside 1.5..300 m, loads outside 0..1, carriers outside 0.5..100 GHz; `InputError` for lengths
    that differ, a bandwidth LTE does not have, or antennas without a gain.
    """

    x_m: FloatArray
    """Position east [m]."""
    y_m: FloatArray
    """Position north [m]."""
    height_m: FloatArray
    """Height of the antenna above ground [m, 1.5..300]."""
    boresight_deg: FloatArray
    """Direction of the panel [deg], 0 = east, counter-clockwise."""
    power_dbm: FloatArray
    """Transmit power over the whole carrier [dBm]."""
    load: FloatArray
    """Share of the carrier in use, 0..1: the sector's power as an interferer is scaled by it."""
    antenna: tuple[Antenna, ...]
    """Antenna of each sector."""
    site: NDArray[np.int64]
    """Number of the site a sector belongs to: sectors of one site share shadowing and LOS state."""
    carrier_hz: FloatArray
    """Carrier frequency [Hz, 0.5e9..100e9]."""
    bandwidth_hz: FloatArray
    """Channel bandwidth [Hz]: 1.4, 3, 5, 10, 15 or 20 MHz."""
    noise_figure_db: float
    """Noise figure of the receiver [dB, 0 or more]."""

    def __post_init__(self) -> None:
        n_sectors = np.size(self.x_m)
        if n_sectors == 0:
            raise InputError("the deployment has no sectors; expected at least 1")
        checked = {
            "x_m": check_range(self.x_m, "x of a sector", -np.inf, np.inf, "m"),
            "y_m": check_range(self.y_m, "y of a sector", -np.inf, np.inf, "m"),
            "height_m": check_heights(self.height_m, "mast height"),
            "boresight_deg": check_range(self.boresight_deg, "boresight", -np.inf, np.inf, "deg"),
            "power_dbm": check_range(self.power_dbm, "power", -np.inf, np.inf, "dBm"),
            "load": check_range(self.load, "load", 0.0, 1.0, ""),
            "site": _site_numbers(self.site),
            "carrier_hz": check_carrier(self.carrier_hz),
            "bandwidth_hz": check_bandwidths(self.bandwidth_hz),
        }
        for name, values in checked.items():
            object.__setattr__(self, name, _per_sector(values, name, n_sectors))
        object.__setattr__(self, "antenna", _antennas(self.antenna, n_sectors))
        check_range(self.noise_figure_db, "noise figure", 0.0, np.inf, "dB")

    @property
    def n_sectors(self) -> int:
        """Number of sectors."""
        return len(self.x_m)

    @cached_property
    def interference(self) -> Interference:
        """Noise, bands and loads of the sectors."""
        return Interference.of(self.carrier_hz, self.bandwidth_hz, self.load, self.noise_figure_db)

    @cached_property
    def masts(self) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """First sector of each distinct (site, place, height, carrier), and the mast of each sector: a link is computed once."""
        place = np.stack([self.site, self.x_m, self.y_m, self.height_m, self.carrier_hz], axis=-1)
        _, first, mast = np.unique(place, axis=0, return_index=True, return_inverse=True)
        return first, mast.reshape(-1)

    @cached_property
    def antenna_groups(self) -> tuple[tuple[Antenna, NDArray[np.int64], NDArray[np.int64]], ...]:
        """Equal antennas put together: (antenna, sectors `[mast, n]`, their masts `[mast]`).

        All masts of a group have the same number n of sectors with that antenna.
        """
        _, mast = self.masts
        by_mast: dict[tuple[Antenna, int], list[int]] = {}
        for sector, antenna in enumerate(self.antenna):
            by_mast.setdefault((antenna, int(mast[sector])), []).append(sector)
        groups: dict[tuple[Antenna, int], list[list[int]]] = {}
        for (antenna, _), sectors in by_mast.items():
            groups.setdefault((antenna, len(sectors)), []).append(sectors)
        return tuple((antenna, np.array(rows), mast[np.array(rows)[:, 0]]) for (antenna, _), rows in groups.items())


def hexagonal_deployment(
    rings: int = HEXAGONAL.rings,
    inter_site_distance_m: float = HEXAGONAL.inter_site_distance_m,
    boresights_deg: Sequence[float] = HEXAGONAL.boresights_deg,
    base_height_m: float = HEXAGONAL.base_height_m,
    power_dbm: ArrayLike = HEXAGONAL.power_dbm,
    carrier_hz: ArrayLike = HEXAGONAL.carrier_hz,
    bandwidth_hz: ArrayLike = HEXAGONAL.bandwidth_hz,
    noise_figure_db: float = HEXAGONAL.noise_figure_db,
    load: ArrayLike = HEXAGONAL.load,
    antenna: Antenna | Sequence[Antenna] = ColumnAntenna.of(HEXAGONAL),  # noqa: B008 (frozen)
) -> Deployment:
    """Sites on a hexagonal lattice around the origin: 1 + 3 rings (rings + 1) sites; the defaults give 7 sites, 21 sectors.

    Order: the centre, then ring by ring, each counter-clockwise from due east (ring 1: 0, 60, ..., 300 degrees);
    sector = site * len(boresights_deg) + index of the boresight. `power_dbm`, `load`, `carrier_hz`, `bandwidth_hz` and
    `antenna` are one for all or one for each sector. Errors as `Deployment`; `InputError` for negative rings, no boresight,
    or a distance not above 0.

    Source: layout of 3GPP TR 36.777 Annex A (hexagonal, three sectors a site).
    """
    if not isinstance(rings, int | np.integer) or rings < 0:
        raise InputError(f"rings is {rings!r}; expected a whole number, 0 (one site) or more")
    if not (np.isfinite(inter_site_distance_m) and inter_site_distance_m > 0):
        raise InputError(f"inter-site distance is {inter_site_distance_m:g} m; expected more than 0 m")
    if len(boresights_deg) == 0:
        raise InputError("boresights_deg is empty; expected at least one direction")
    sites = inter_site_distance_m * _hexagonal_lattice(int(rings))
    n_boresights = len(boresights_deg)
    x_m, y_m = np.repeat(sites, n_boresights, axis=0).T
    return Deployment(
        x_m=x_m,
        y_m=y_m,
        height_m=cast(Any, base_height_m),
        boresight_deg=np.tile(as_floats(boresights_deg, "boresights_deg"), len(sites)),
        power_dbm=cast(Any, power_dbm),
        load=cast(Any, load),
        antenna=cast(Any, antenna),
        site=np.repeat(np.arange(len(sites)), n_boresights),
        carrier_hz=cast(Any, carrier_hz),
        bandwidth_hz=cast(Any, bandwidth_hz),
        noise_figure_db=noise_figure_db,
    )


def _hexagonal_lattice(rings: int) -> FloatArray:
    """Places `[site, 2]` at unit distance, in the order `hexagonal_deployment` states."""
    corners = np.array([(np.cos(angle), np.sin(angle)) for angle in np.radians(np.arange(0, 420, 60))])
    places = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        along = np.arange(ring)[:, None] / ring
        places += [ring * (start + along * (end - start)) for start, end in pairwise(corners)]
    return np.concatenate(places)


def _per_sector(values: NDArray[Any], name: str, n_sectors: int) -> NDArray[Any]:
    """A read-only copy `[sector]` of one value or one per sector."""
    if values.shape not in ((), (1,), (n_sectors,)):
        raise InputError(f"{name} has shape {values.shape}; expected one value or {n_sectors}, one for each sector")
    array = np.broadcast_to(values, n_sectors).copy()
    array.flags.writeable = False
    return array


def _site_numbers(site: ArrayLike) -> NDArray[np.int64]:
    numbers = as_floats(site, "site")
    if not (np.isfinite(numbers) & (numbers >= 0) & (numbers == np.floor(numbers))).all():
        raise InputError(f"site is {site!r}; expected whole numbers, 0 or more")
    return numbers.astype(np.int64)


def _antennas(antenna: Any, n_sectors: int) -> tuple[Antenna, ...]:
    antennas = tuple(antenna) if isinstance(antenna, Sequence) else (antenna,) * n_sectors
    if len(antennas) != n_sectors:
        raise InputError(f"{len(antennas)} antennas for {n_sectors} sectors; expected one for all or one for each sector")
    if not all(hasattr(each, "gain_dbi") for each in antennas):
        raise InputError("an antenna has no gain_dbi(azimuth_deg, zenith_deg); use ColumnAntenna or a class with that method")
    return antennas
