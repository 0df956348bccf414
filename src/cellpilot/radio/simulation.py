"""Received power, serving sector and SINR of a deployment at points in space."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtr

from cellpilot.errors import InputError, RangeError
from cellpilot.radio.deployment import Deployment
from cellpilot.radio.propagation import check_heights, environment_named, los_probability, path_loss_db, shadow_std_db
from cellpilot.radio.ranges import FloatArray, check_range
from cellpilot.radio.shadowing import SITE_CORRELATION, CorrelatedFields, Shadowing, draw_shadowing
from cellpilot.units import from_db, to_db

LosMode = Literal["soft", "sampled", "los", "nlos"]

CHUNK_LINKS = 2**18
"""Links (sector x point) computed at once: bounds the memory to some tens of MB."""


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


def simulate(
    deployment: Deployment,
    x_m: ArrayLike,
    y_m: ArrayLike,
    z_m: ArrayLike,
    environment: str = "UMa-AV",
    los: LosMode = "soft",
    shadowing_seed: int | None = None,
    site_correlation: float = SITE_CORRELATION,
) -> Reception:
    """Serving sector, its power and the SINR at points (x, y, z) [m], as a `Reception` in their broadcast shape.

    The strongest sector serves; all others interfere with their power times load. Points, modes, ranges and errors as
    `received_power_dbm`.

    Source: RSRP as 3GPP TS 36.214 clause 5.1.1, the carrier's power spread evenly over its subcarriers.
    """
    points = _Points.of(x_m, y_m, z_m)
    sinr_db, power_dbm = np.empty(points.x_m.size), np.empty(points.x_m.size)
    serving_sector = np.empty(points.x_m.size, dtype=np.int64)
    noise_mw = from_db(deployment.noise_dbm)
    for chunk, sector_dbm in _power_chunks(deployment, points, environment, los, shadowing_seed, site_correlation):
        serving = sector_dbm.argmax(axis=0)[None]
        interference_mw = deployment.load[:, None] * from_db(sector_dbm)
        # Zeroing the serving sector instead of subtracting it from the total: interferers may lie 75 dB below it.
        np.put_along_axis(interference_mw, serving, 0.0, axis=0)
        power_dbm[chunk] = np.take_along_axis(sector_dbm, serving, axis=0)[0]
        sinr_db[chunk] = power_dbm[chunk] - to_db(interference_mw.sum(axis=0) + noise_mw)
        serving_sector[chunk] = serving[0]
    return Reception(
        sinr_db=sinr_db.reshape(points.shape),
        wideband_power_dbm=power_dbm.reshape(points.shape),
        rsrp_dbm=(power_dbm - 10.0 * np.log10(deployment.n_subcarriers)).reshape(points.shape),
        serving_sector=serving_sector.reshape(points.shape),
    )


def received_power_dbm(
    deployment: Deployment,
    x_m: ArrayLike,
    y_m: ArrayLike,
    z_m: ArrayLike,
    environment: str = "UMa-AV",
    los: LosMode = "soft",
    shadowing_seed: int | None = None,
    site_correlation: float = SITE_CORRELATION,
) -> FloatArray:
    """Power of every sector over the whole carrier [dBm], `[sector, ...]` with the broadcast shape of the points behind.

    `los`: "soft" averages LOS and NLOS gain in linear power with the LOS probability; "sampled" makes each link of site
    and point one or the other by a spatially consistent field (needs a seed); "los" and "nlos" force the state.
    `shadowing_seed` adds correlated shadow fading, None leaves it out. A positive shadowing value is extra loss; one
    horizontal field of each site and state serves all heights, scaled by the spread at that height.

    `RangeError` for heights outside 1.5..300 m, points that are not finite, or "nlos" where the standard defines LOS
    only; `InputError` for an unknown environment or mode, or "sampled" without a seed.

    Source: 3GPP TR 36.777 Annex B, TR 38.901 clauses 7.3, 7.4.4 and 7.6.3.3.
    """
    points = _Points.of(x_m, y_m, z_m)
    power_dbm = np.empty((deployment.n_sectors, points.x_m.size))
    for chunk, sector_dbm in _power_chunks(deployment, points, environment, los, shadowing_seed, site_correlation):
        power_dbm[:, chunk] = sector_dbm
    return power_dbm.reshape(deployment.n_sectors, *points.shape)


@dataclass(frozen=True, eq=False)
class _Points:
    """Checked points, flat, and the shape they came in."""

    x_m: FloatArray
    y_m: FloatArray
    z_m: FloatArray
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
        return cls(x_m.ravel(), y_m.ravel(), z_m.ravel(), x_m.shape)


def _power_chunks(
    deployment: Deployment,
    points: _Points,
    environment: str,
    los: LosMode,
    shadowing_seed: int | None,
    site_correlation: float,
) -> Iterator[tuple[NDArray[np.int64], FloatArray]]:
    """Point numbers `[chunk]` and the power of every sector there `[sector, chunk]` [dBm]."""
    model = environment_named(environment)
    if los not in get_args(LosMode):
        raise InputError(f"los is {los!r}; expected one of {', '.join(get_args(LosMode))}")
    order = np.arange(points.x_m.size)
    shadowing = None
    if shadowing_seed is not None:
        first, _ = deployment.masts
        shadowing = draw_shadowing(shadowing_seed, model, deployment.site[first], site_correlation)
        # Points above each other share the value of a field: keep them in one chunk, where it is computed once.
        order = np.lexsort((points.y_m, points.x_m))
    elif los == "sampled":
        raise InputError('los is "sampled" without a seed; give shadowing_seed, a whole number, or use los "soft"')
    size = max(1, CHUNK_LINKS // deployment.n_sectors)
    for start in range(0, order.size, size):
        chunk = order[start : start + size]
        yield (
            chunk,
            _sector_power_dbm(deployment, points.x_m[chunk], points.y_m[chunk], points.z_m[chunk], environment, los, shadowing),
        )


def _sector_power_dbm(
    deployment: Deployment,
    x_m: FloatArray,
    y_m: FloatArray,
    z_m: FloatArray,
    environment: str,
    los: LosMode,
    shadowing: Shadowing | None,
) -> FloatArray:
    """Power `[sector, point]` [dBm]: loss and direction once for each mast, gain for each sector on it."""
    first, mast = deployment.masts
    east_m, north_m = x_m - deployment.x_m[first, None], y_m - deployment.y_m[first, None]
    distance_2d_m = np.hypot(east_m, north_m)
    base_height_m = deployment.height_m[first, None]
    loss_db = _loss_db(deployment.carrier_hz, distance_2d_m, base_height_m, x_m, y_m, z_m, environment, los, shadowing)
    azimuth_deg = np.degrees(np.arctan2(north_m, east_m))
    zenith_deg = np.degrees(np.arctan2(distance_2d_m, z_m - base_height_m))
    gain_dbi = [
        antenna.gain_dbi(azimuth_deg[m] - boresight_deg, zenith_deg[m])
        for antenna, boresight_deg, m in zip(deployment.antenna, deployment.boresight_deg, mast, strict=True)
    ]
    return np.asarray(deployment.power_dbm[:, None] + np.stack(gain_dbi) - loss_db[mast])


def _loss_db(
    carrier_hz: float,
    distance_2d_m: FloatArray,
    base_height_m: FloatArray,
    x_m: FloatArray,
    y_m: FloatArray,
    z_m: FloatArray,
    environment: str,
    los: LosMode,
    shadowing: Shadowing | None,
) -> FloatArray:
    """Loss `[mast, point]` [dB] in a LOS mode, shadowing included."""
    los_db, nlos_db = path_loss_db(environment, carrier_hz, distance_2d_m, base_height_m, z_m)
    if shadowing is not None:
        std_los_db, std_nlos_db = shadow_std_db(environment, carrier_hz, distance_2d_m, base_height_m, z_m)
        place, where = np.unique(x_m + 1j * y_m, return_inverse=True)

        def field(fields: CorrelatedFields) -> FloatArray:
            return fields.at(place.real, place.imag)[:, where]

        if los != "nlos":
            los_db = los_db + std_los_db * field(shadowing.los)
        if los != "los":
            nlos_db = nlos_db + std_nlos_db * field(shadowing.nlos)
        if los == "sampled":
            sees = ndtr(field(shadowing.state)) <= los_probability(environment, distance_2d_m, z_m)
            return np.where(sees, los_db, nlos_db)
    if los == "los":
        return los_db
    if los == "nlos":
        undefined = np.isnan(nlos_db).any(axis=0)
        if undefined.any():
            raise RangeError(f'{environment} at {z_m[undefined][0]:g} m knows only LOS; fly lower or use los "soft"')
        return nlos_db
    probability = los_probability(environment, distance_2d_m, z_m)
    # NLOS is NaN where it cannot occur; 0 x NaN must not reach the sum.
    nlos_gain = np.where(probability < 1.0, (1.0 - probability) * from_db(-nlos_db), 0.0)
    return -to_db(probability * from_db(-los_db) + nlos_gain)
