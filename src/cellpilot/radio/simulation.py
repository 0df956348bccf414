"""Received power, serving sector and SINR of a deployment at points in space."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from cellpilot.array_types import IndexArray
from cellpilot.errors import InputError, RangeError
from cellpilot.provenance import usable_cores
from cellpilot.radio import fast
from cellpilot.radio.deployment import Deployment
from cellpilot.radio.environment import Environment
from cellpilot.radio.propagation import check_heights, environment_named, link_to
from cellpilot.radio.ranges import FloatArray, check_range
from cellpilot.radio.settings import PROPAGATION, LosMode
from cellpilot.radio.shadowing import SITE_CORRELATION, Shadowing, draw_shadowing
from cellpilot.units import from_db, to_db

CHUNK_LINKS = 2**15
"""Links (mast x place) computed at once: arrays of 256 kB stay in the cache."""


@dataclass(frozen=True, eq=False)
class Reception:
    """What a receiver gets; every array has the broadcast shape of the points."""

    sinr_db: FloatArray
    """Signal to interference and noise of the serving sector [dB]."""
    wideband_power_dbm: FloatArray
    """Power of the serving sector over the whole carrier [dBm]."""
    rsrp_dbm: FloatArray
    """Power of the serving sector in one subcarrier [dBm]."""
    serving_sector: NDArray[np.int64]
    """Index of the strongest sector."""
    sector_rsrp_dbm: FloatArray | None = None
    """Power of every sector in one subcarrier [dBm], `[sector, ...]`, if it was asked for."""


def simulate(
    deployment: Deployment,
    x_m: ArrayLike,
    y_m: ArrayLike,
    z_m: ArrayLike,
    environment: str = PROPAGATION.environment,
    los: LosMode = PROPAGATION.los,
    shadowing_seed: int | None = None,
    site_correlation: float = SITE_CORRELATION,
    every_sector: bool = False,
) -> Reception:
    """Serving sector, its power and the SINR at points (x, y, z) [m], as a `Reception` in their broadcast shape.

    The sector of the strongest RSRP serves; all others interfere with what of their power times load falls into its band.
    With `every_sector` the RSRP of all sectors is kept as well.
    Points, modes, ranges and errors as `received_power_dbm`.

    Source: RSRP as 3GPP TS 36.214 clause 5.1.1, the carrier's power spread evenly over its subcarriers.
    """
    points = _Points.of(x_m, y_m, z_m)
    sinr_db, power_dbm = np.empty(points.size), np.empty(points.size)
    serving_sector = np.empty(points.size, dtype=np.int64)
    subcarriers_db = deployment.interference.subcarriers_db
    sector_rsrp_dbm = np.empty((deployment.n_sectors, points.size)) if every_sector else None

    def receive(at: IndexArray, sector_dbm: FloatArray) -> None:
        serving_sector[at], power_dbm[at], sinr_db[at] = deployment.interference.serve(sector_dbm)
        if sector_rsrp_dbm is not None:
            sector_rsrp_dbm[:, at] = sector_dbm - subcarriers_db[:, None]

    _for_each_level(deployment, points, environment, los, shadowing_seed, site_correlation, receive)
    return Reception(
        sinr_db=sinr_db.reshape(points.shape),
        wideband_power_dbm=power_dbm.reshape(points.shape),
        rsrp_dbm=(power_dbm - subcarriers_db[serving_sector]).reshape(points.shape),
        serving_sector=serving_sector.reshape(points.shape),
        sector_rsrp_dbm=None if sector_rsrp_dbm is None else sector_rsrp_dbm.reshape(-1, *points.shape),
    )


def received_power_dbm(
    deployment: Deployment,
    x_m: ArrayLike,
    y_m: ArrayLike,
    z_m: ArrayLike,
    environment: str = PROPAGATION.environment,
    los: LosMode = PROPAGATION.los,
    shadowing_seed: int | None = None,
    site_correlation: float = SITE_CORRELATION,
) -> FloatArray:
    """Power of every sector over the whole carrier [dBm], `[sector, ...]` with the broadcast shape of the points behind.

    `los`: "soft" averages LOS and NLOS gain in linear power with the LOS probability; "sampled" makes each link of site
    and point one or the other by a spatially consistent field (needs a seed); "los" and "nlos" force the state.
    `shadowing_seed` adds correlated shadow fading, None leaves it out. A positive shadowing value is extra loss; one
    horizontal field of each site and state serves all heights, scaled by the spread at that height.

    `RangeError` for heights outside 1.5..300 m, points that are not finite, or "nlos" where the standard defines LOS
    only (or, with shadowing, no NLOS spread); `InputError` for an unknown environment or mode, or "sampled" without a seed.

    Source: 3GPP TR 36.777 Annex B, TR 38.901 clauses 7.3, 7.4.4 and 7.6.3.3.
    """
    points = _Points.of(x_m, y_m, z_m)
    power_dbm = np.empty((deployment.n_sectors, points.size))

    def keep(at: IndexArray, sector_dbm: FloatArray) -> None:
        power_dbm[:, at] = sector_dbm

    _for_each_level(deployment, points, environment, los, shadowing_seed, site_correlation, keep)
    return power_dbm.reshape(deployment.n_sectors, *points.shape)


@dataclass(frozen=True, eq=False)
class _Points:
    """Checked points, flat, in the shape they came in, and the places in the plane above which they lie."""

    z_m: FloatArray  # [point]
    place: IndexArray  # [point] number of the place below
    x_m: FloatArray  # [place] all different
    y_m: FloatArray  # [place]
    shape: tuple[int, ...]

    @classmethod
    def of(cls, x_m: ArrayLike, y_m: ArrayLike, z_m: ArrayLike) -> "_Points":
        x_m = check_range(x_m, "x", -np.inf, np.inf, "m")
        y_m = check_range(y_m, "y", -np.inf, np.inf, "m")
        z_m = check_heights(z_m)
        try:
            x_m, y_m, z_m = np.broadcast_arrays(x_m, y_m, z_m)
        except ValueError as error:
            raise InputError(f"x, y and z have shapes {x_m.shape}, {y_m.shape}, {z_m.shape} that do not broadcast") from error
        places, place = np.unique(x_m.ravel() + 1j * y_m.ravel(), return_inverse=True)
        return cls(z_m.ravel(), place.reshape(-1), places.real, places.imag, x_m.shape)

    @property
    def size(self) -> int:
        """Number of points."""
        return self.z_m.size


def _for_each_level(
    deployment: Deployment,
    points: _Points,
    environment: str,
    los: LosMode,
    shadowing_seed: int | None,
    site_correlation: float,
    use: Callable[[IndexArray, FloatArray], None],
) -> None:
    """Call `use(points [n], power [sector, n] [dBm])` for some points of one height at a time, until all had their turn.

    Chunks of places are shared among threads; NumPy computes outside the interpreter's lock.
    """
    model = environment_named(environment)
    if los not in get_args(LosMode):
        raise InputError(f"los is {los!r}; expected one of {', '.join(get_args(LosMode))}")
    if los == "nlos":
        _check_nlos(environment, model, points, shadowing_seed is not None)
    shadowing = None
    if shadowing_seed is not None:
        first, _ = deployment.masts
        shadowing = draw_shadowing(shadowing_seed, model, deployment.site[first], site_correlation)
    elif los == "sampled":
        raise InputError('los is "sampled" without a seed; give shadowing_seed, a whole number, or use los "soft"')
    order = np.lexsort((points.z_m, points.place))
    size = max(1, CHUNK_LINKS // len(deployment.masts[0]))
    starts = range(0, len(points.x_m), size)
    edges = np.searchsorted(points.place[order], [*starts, len(points.x_m)])

    def chunk(number: int) -> None:
        places = slice(starts[number], min(starts[number] + size, len(points.x_m)))
        above = order[edges[number] : edges[number + 1]]
        sight = _Sight.of(deployment, model, los, shadowing, points.x_m[places], points.y_m[places])
        for height_m in np.unique(points.z_m[above]).tolist():
            at = above[points.z_m[above] == height_m]
            use(at, sight.sector_power_dbm(height_m, points.place[at] - places.start))

    with ThreadPoolExecutor(usable_cores()) as pool:
        for _ in pool.map(chunk, range(len(starts))):
            pass


def _check_nlos(environment: str, model: Environment, points: _Points, shadowed: bool) -> None:
    for height_m in np.unique(points.z_m).tolist():
        link = link_to(np.full(1, 2e9), np.full(1, 100.0), np.full(1, 25.0), height_m)
        if model.path_loss_db(link)[1] is None:
            raise RangeError(f'{environment} at {height_m:g} m knows only LOS; fly lower or use los "soft"')
        if shadowed and model.shadow_std_db(link)[1] is None:
            raise RangeError(
                f"{environment} at {height_m:g} m knows no NLOS shadowing; fly lower or leave out the shadowing seed"
            )


@dataclass(frozen=True, eq=False)
class _Sight:
    """What the masts see of some places, the same for all heights above them; arrays `[mast, place]`."""

    deployment: Deployment
    model: Environment
    los: LosMode
    distance_2d_m: FloatArray
    azimuth_deg: FloatArray
    fields: dict[str, FloatArray]  # kind -> standard normal field, if there is shadowing

    @classmethod
    def of(
        cls,
        deployment: Deployment,
        model: Environment,
        los: LosMode,
        shadowing: Shadowing | None,
        x_m: FloatArray,
        y_m: FloatArray,
    ) -> "_Sight":
        first, _ = deployment.masts
        east_m, north_m = x_m - deployment.x_m[first, None], y_m - deployment.y_m[first, None]
        needed = {"los": ("los",), "nlos": ("nlos",), "soft": ("los", "nlos"), "sampled": ("los", "nlos", "state")}[los]
        fields = {} if shadowing is None else {kind: getattr(shadowing, kind).at(x_m, y_m) for kind in needed}
        azimuth_deg = np.degrees(np.arctan2(north_m, east_m))
        return cls(deployment, model, los, fast.distance_m(east_m, north_m), azimuth_deg, fields)

    def sector_power_dbm(self, height_m: float, place: IndexArray) -> FloatArray:
        """Power `[sector, point]` [dBm] at points of one height above the numbered places."""
        whole = place.size == self.distance_2d_m.shape[1] and bool((place == np.arange(place.size)).all())
        at = (lambda values: values) if whole else (lambda values: values[:, place])
        deployment, (first, _) = self.deployment, self.deployment.masts
        distance_2d_m, azimuth_deg, base_height_m = at(self.distance_2d_m), at(self.azimuth_deg), deployment.height_m[first, None]
        loss_db = self._loss_db(height_m, distance_2d_m, {kind: at(field) for kind, field in self.fields.items()})
        zenith_deg = np.degrees(np.arctan2(distance_2d_m, height_m - base_height_m))
        power_dbm = np.empty((deployment.n_sectors, place.size))
        for antenna, sectors, masts in deployment.antenna_groups:
            from_boresight_deg = azimuth_deg[masts, None] - deployment.boresight_deg[sectors][..., None]
            gain_dbi = antenna.gain_dbi(from_boresight_deg, zenith_deg[masts, None])
            power_dbm[sectors] = gain_dbi + (deployment.power_dbm[sectors][..., None] - loss_db[masts, None])
        return power_dbm

    def _loss_db(self, height_m: float, distance_2d_m: FloatArray, fields: dict[str, FloatArray]) -> FloatArray:
        """Loss `[mast, point]` [dB] in the LOS mode, shadowing included."""
        first, _ = self.deployment.masts
        link = link_to(self.deployment.carrier_hz[first, None], distance_2d_m, self.deployment.height_m[first, None], height_m)
        los_db, nlos_db = self.model.path_loss_db(link)
        std_los_db, std_nlos_db = self.model.shadow_std_db(link) if fields else (None, None)
        if std_los_db is not None and "los" in fields:
            los_db = los_db + std_los_db * fields["los"]
        if std_nlos_db is not None and nlos_db is not None and "nlos" in fields:
            nlos_db = nlos_db + std_nlos_db * fields["nlos"]
        if self.los == "los" or nlos_db is None:
            return los_db
        if self.los == "nlos":
            return nlos_db
        probability = self.model.los_probability(distance_2d_m, height_m)
        if self.los == "sampled":
            return np.where(ndtr(fields["state"]) <= probability, los_db, nlos_db)
        return -to_db(probability * from_db(-los_db) + (1.0 - probability) * from_db(-nlos_db))
