"""What a propagation model has to state, and the forms several of them share."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from cellpilot.radio import fast
from cellpilot.radio.ranges import FloatArray

SPEED_OF_LIGHT_M_S = 3.0e8
"""As TR 38.901 Table 7.4.1-1 note 1 rounds it; the exact value would move the break points."""

EFFECTIVE_ENVIRONMENT_HEIGHT_M = 1.0
"""hE of TR 38.901 Table 7.4.1-1 note 1. UMa draws it at random above 13 m; a map needs one value, so the main one is used."""


@dataclass(frozen=True)
class Link:
    """Geometry and carrier of links to receivers of one height; the arrays broadcast, distances are already floored."""

    carrier_ghz: FloatArray
    distance_2d_m: FloatArray
    distance_3d_m: FloatArray
    base_height_m: FloatArray
    height_m: float


Losses = tuple[FloatArray, FloatArray | None]
"""LOS and NLOS value [dB]; None where the source knows LOS only."""


@dataclass(frozen=True)
class Environment:
    """One propagation model: its formulas, and the correlation distances of shadowing and of the LOS state.

    `los_probability` takes horizontal distances and one height [m], `path_loss_db` and `shadow_std_db` a `Link`: formulas
    are chosen by height once, not for each value. Results broadcast with the distances. The callers have checked ranges.
    """

    los_probability: Callable[[FloatArray, float], FloatArray]
    path_loss_db: Callable[[Link], Losses]
    shadow_std_db: Callable[[Link], Losses]
    correlation_los_m: float
    correlation_nlos_m: float
    correlation_state_m: float


def decaying_probability(distance_2d_m: FloatArray, certain_m: float, decay_m: float) -> FloatArray:
    """1 up to `certain_m`, then d1/d + exp(-d/p1)(1 - d1/d): the form of TR 36.777 Table B-1 and of TR 38.901 Table 7.4.2-1."""
    share = certain_m / np.maximum(distance_2d_m, certain_m)
    return np.asarray(share + fast.exp(distance_2d_m / -decay_m) * (1.0 - share))


def free_space_db(link: Link) -> FloatArray:
    """Free-space loss 20 log10(40 pi d fc / 3), the form of TR 38.901 Table 7.4.1-1 (RMa)."""
    return np.asarray(20.0 * np.log10(40.0 * np.pi * link.distance_3d_m * link.carrier_ghz / 3.0))


def carrier_db(link: Link) -> FloatArray:
    """20 log10(40 pi fc / 3): free-space loss at 1 m."""
    return np.asarray(20.0 * np.log10(40.0 * np.pi * link.carrier_ghz / 3.0))


def effective_break_point_m(link: Link) -> FloatArray:
    """d'BP = 4 (hBS - hE)(hUT - hE) fc / c of TR 38.901 Table 7.4.1-1 note 1 (UMa, UMi)."""
    heights_m2 = (link.base_height_m - EFFECTIVE_ENVIRONMENT_HEIGHT_M) * (link.height_m - EFFECTIVE_ENVIRONMENT_HEIGHT_M)
    return np.asarray(4.0 * heights_m2 * link.carrier_ghz * 1e9 / SPEED_OF_LIGHT_M_S)


def two_slopes_db(link: Link, intercept_db: float, slope: float, far_correction: float) -> FloatArray:
    """LOS loss with a second slope of 40 dB per decade beyond d'BP: TR 38.901 Table 7.4.1-1 (UMa, UMi)."""
    break_m = effective_break_point_m(link)
    log_distance = np.log10(link.distance_3d_m)
    base_db = intercept_db + 20.0 * np.log10(link.carrier_ghz)
    far_db = 40.0 * log_distance - far_correction * np.log10(break_m**2 + (link.base_height_m - link.height_m) ** 2)
    return np.asarray(base_db + np.where(link.distance_2d_m <= break_m, slope * log_distance, far_db))
