"""Rural macro with aerial vehicles: 3GPP TR 36.777 Annex B, below 10 m the RMa of TR 38.901. Fitted for 35 m masts."""

import numpy as np

from cellpilot.radio import fast
from cellpilot.radio.environment import (
    SPEED_OF_LIGHT_M_S,
    Environment,
    Link,
    Losses,
    carrier_db,
    decaying_probability,
)
from cellpilot.radio.ranges import FloatArray

_AERIAL_ABOVE_M = 10.0
_LOS_ONLY_ABOVE_M = 40.0
BUILDING_HEIGHT_M = 5.0
STREET_WIDTH_M = 20.0


def _los_probability(distance_2d_m: FloatArray, height_m: float) -> FloatArray:
    """Table B-1; at and below 10 m TR 38.901 Table 7.4.2-1."""
    if height_m > _LOS_ONLY_ABOVE_M:
        return np.ones(1)
    if height_m > _AERIAL_ABOVE_M:
        log_height = np.log10(height_m)
        certain_m, decay_m = max(1350.8 * log_height - 1602.0, 18.0), max(15021.0 * log_height - 16053.0, 1000.0)
        return decaying_probability(distance_2d_m, certain_m, decay_m)
    return fast.exp(np.maximum(distance_2d_m - 10.0, 0.0) / -1000.0)


def _break_point_m(link: Link) -> FloatArray:
    """dBP = 2 pi hBS hUT fc / c (TR 38.901 Table 7.4.1-1 note 5)."""
    return np.asarray(2.0 * np.pi * link.base_height_m * link.height_m * link.carrier_ghz * 1e9 / SPEED_OF_LIGHT_M_S)


def _ground_los_db(link: Link) -> FloatArray:
    break_m = _break_point_m(link)
    near_m = np.where(link.distance_2d_m <= break_m, link.distance_3d_m, break_m)
    free_db = carrier_db(link) + 20.0 * np.log10(near_m)
    slope = min(0.03 * BUILDING_HEIGHT_M**1.72, 10.0)
    offset_db = min(0.044 * BUILDING_HEIGHT_M**1.72, 14.77)
    near_db = free_db + slope * np.log10(near_m) - offset_db + 0.002 * np.log10(BUILDING_HEIGHT_M) * near_m
    return np.asarray(near_db + 40.0 * np.log10(link.distance_3d_m / near_m))


def _ground_nlos_db(link: Link) -> FloatArray:
    log_base = np.log10(link.base_height_m)
    roofs_db = 7.5 * np.log10(BUILDING_HEIGHT_M) - 7.1 * np.log10(STREET_WIDTH_M)
    mast_db = (24.37 - 3.7 * (BUILDING_HEIGHT_M / link.base_height_m) ** 2) * log_base
    distance_db = (43.42 - 3.1 * log_base) * (np.log10(link.distance_3d_m) - 3.0)
    receiver_db = 3.2 * np.log10(11.75 * link.height_m) ** 2 - 4.97
    return np.asarray(161.04 + roofs_db - mast_db + distance_db + 20.0 * np.log10(link.carrier_ghz) - receiver_db)


def _path_loss_db(link: Link) -> Losses:
    """Table B-2; at and below 10 m TR 38.901 Table 7.4.1-1."""
    if link.height_m <= _AERIAL_ABOVE_M:
        los_db, nlos_db = _ground_los_db(link), _ground_nlos_db(link)
    else:
        log_distance, log_height = np.log10(link.distance_3d_m), np.log10(link.height_m)
        los_db = max(23.9 - 1.8 * log_height, 20.0) * log_distance + carrier_db(link)
        nlos_db = (35.0 - 5.3 * log_height) * log_distance + (carrier_db(link) - 12.0)
    return los_db, np.maximum(los_db, nlos_db)


def _shadow_std_db(link: Link) -> Losses:
    """Table B-3. Above 40 m it has no NLOS value, although Table B-2 has a path loss."""
    if link.height_m <= _AERIAL_ABOVE_M:
        return np.where(link.distance_2d_m < _break_point_m(link), 4.0, 6.0), np.full(1, 8.0)
    nlos_db = np.full(1, 6.0) if link.height_m <= _LOS_ONLY_ABOVE_M else None
    return np.full(1, 4.2 * np.exp(-0.0046 * link.height_m)), nlos_db


# Correlation distances: TR 38.901 Table 7.5-6 (shadowing) and Table 7.6.3.1-2 (LOS state).
RMA_AV = Environment(_los_probability, _path_loss_db, _shadow_std_db, 37.0, 120.0, 60.0)
