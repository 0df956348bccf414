"""LOS probability, path loss and shadowing spread of a named environment.

A new model is one file that builds an `Environment`, and one line in `ENVIRONMENTS`.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.radio import fast
from cellpilot.radio.environment import Environment, Link, Losses
from cellpilot.radio.ranges import FloatArray, check_range
from cellpilot.radio.rma_av import RMA_AV
from cellpilot.radio.uma_av import UMA_AV
from cellpilot.radio.umi_av import UMI_AV

ENVIRONMENTS: dict[str, Environment] = {
    "RMa-AV": RMA_AV,
    "UMa-AV": UMA_AV,
    "UMi-AV": UMI_AV,
}

HEIGHT_RANGE_M = (1.5, 300.0)
"""Receiver heights for which TR 36.777 Annex B is defined; masts are held to it as well, as the formulas need hBS > 1 m."""

CARRIER_RANGE_HZ = (0.5e9, 100e9)
"""Carriers of TR 38.901 clause 7.1."""

MIN_DISTANCE_2D_M = 0.5
MIN_DISTANCE_3D_M = 1.0


def environment_named(environment: str) -> Environment:
    """The model of that name; `InputError` listing the known names otherwise."""
    if environment not in ENVIRONMENTS:
        raise InputError(f"environment is {environment!r}; expected one of {', '.join(ENVIRONMENTS)}")
    return ENVIRONMENTS[environment]


def check_heights(height_m: ArrayLike, what: str = "height") -> FloatArray:
    """The heights [m] as float64; `RangeError` outside 1.5..300 m."""
    return check_range(height_m, what, *HEIGHT_RANGE_M, "m")


def check_carrier(carrier_hz: ArrayLike) -> FloatArray:
    """The carriers [Hz] as float64; `RangeError` outside 0.5..100 GHz."""
    return check_range(carrier_hz, "carrier", *CARRIER_RANGE_HZ, "Hz")


def los_probability(environment: str, distance_2d_m: ArrayLike, height_m: ArrayLike) -> FloatArray:
    """Probability of line of sight, 0..1, in the broadcast shape of the arguments.

    `distance_2d_m` is horizontal [m, >= 0], `height_m` that of the receiver [m, 1.5..300]; `RangeError` outside,
    `InputError` for an unknown environment. It jumps where the aerial formula takes over (UMa and UMi 22.5 m, RMa 10 m),
    as in the standard. Cut at 1, which the ground UMa product exceeds just beyond 18 m.
    The standard states the formulas for distances of a few km; farther ones are extrapolated.

    Source: 3GPP TR 36.777 Table B-1; below the aerial heights TR 38.901 Table 7.4.2-1.
    """
    model = environment_named(environment)
    distance_2d_m = check_range(distance_2d_m, "horizontal distance", 0.0, np.inf, "m")
    distance_2d_m, height_m = np.broadcast_arrays(distance_2d_m, check_heights(height_m))
    probability = np.empty(height_m.shape)
    for level_m in np.unique(height_m):
        at = height_m == level_m
        probability[at] = model.los_probability(distance_2d_m[at], float(level_m))
    return probability


def path_loss_db(
    environment: str, carrier_hz: ArrayLike, distance_2d_m: ArrayLike, base_height_m: ArrayLike, height_m: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Median path loss (LOS, NLOS) [dB], each in the broadcast shape of the arguments.

    Carrier [Hz, 0.5e9..100e9], horizontal distance_m [m, >= 0], heights of mast and receiver [m, 1.5..300]; `RangeError`
    outside, `InputError` for an unknown environment. NLOS is NaN where the standard knows LOS only (UMa-AV above 100 m).
    Close to the mast the horizontal distance_m counts as at least 0.5 m and the slant distance_m as at least 1 m.

    Source: 3GPP TR 36.777 Table B-2; below the aerial heights TR 38.901 Table 7.4.1-1.
    """
    return _by_height(environment_named(environment).path_loss_db, carrier_hz, distance_2d_m, base_height_m, height_m)


def shadow_std_db(
    environment: str, carrier_hz: ArrayLike, distance_2d_m: ArrayLike, base_height_m: ArrayLike, height_m: ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Standard deviation of shadow fading (LOS, NLOS) [dB], each in the broadcast shape of the arguments.

    Arguments, ranges and errors as `path_loss_db`. NLOS is NaN where the standard knows LOS only
    (UMa-AV above 100 m, RMa-AV above 40 m).

    Source: 3GPP TR 36.777 Table B-3.
    """
    return _by_height(environment_named(environment).shadow_std_db, carrier_hz, distance_2d_m, base_height_m, height_m)


def _by_height(
    formula: Callable[[Link], Losses],
    carrier_hz: ArrayLike,
    distance_2d_m: ArrayLike,
    base_height_m: ArrayLike,
    height_m: ArrayLike,
) -> tuple[FloatArray, FloatArray]:
    """A formula of links over checked arrays of one shape, NaN where it knows no NLOS value."""
    carrier_hz, distance_2d_m, base_height_m, height_m = np.broadcast_arrays(
        check_carrier(carrier_hz),
        check_range(distance_2d_m, "horizontal distance", 0.0, np.inf, "m"),
        check_heights(base_height_m, "mast height"),
        check_heights(height_m),
    )
    los_db, nlos_db = np.empty(height_m.shape), np.empty(height_m.shape)
    for level_m in np.unique(height_m):
        at = height_m == level_m
        los_db[at], nlos = formula(link_to(carrier_hz[at], distance_2d_m[at], base_height_m[at], float(level_m)))
        nlos_db[at] = np.nan if nlos is None else nlos
    return los_db, nlos_db


def link_to(carrier_hz: FloatArray, distance_2d_m: FloatArray, base_height_m: FloatArray, height_m: float) -> Link:
    """Links of checked geometry to receivers of one height, with the distances floored."""
    floored_2d_m = np.maximum(distance_2d_m, MIN_DISTANCE_2D_M)
    distance_3d_m = np.maximum(fast.distance_m(floored_2d_m, height_m - base_height_m), MIN_DISTANCE_3D_M)
    return Link(carrier_hz / 1e9, floored_2d_m, distance_3d_m, base_height_m, height_m)
