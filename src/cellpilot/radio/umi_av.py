"""Urban micro with aerial vehicles: 3GPP TR 36.777 Annex B, below 22.5 m the UMi of TR 38.901. Fitted for 10 m masts."""

import numpy as np

from cellpilot.radio.environment import Environment, Link, Losses, decaying_probability, free_space_db, two_slopes_db
from cellpilot.radio.ranges import FloatArray

_AERIAL_ABOVE_M = 22.5


def _los_probability(distance_2d_m: FloatArray, height_m: float) -> FloatArray:
    """Table B-1; at and below 22.5 m TR 38.901 Table 7.4.2-1."""
    if height_m <= _AERIAL_ABOVE_M:
        return decaying_probability(distance_2d_m, 18.0, 36.0)
    log_height = np.log10(height_m)
    return decaying_probability(distance_2d_m, max(294.05 * log_height - 432.94, 18.0), 233.98 * log_height - 0.95)


def _path_loss_db(link: Link) -> Losses:
    """Table B-2; at and below 22.5 m TR 38.901 Table 7.4.1-1."""
    log_distance, log_height, log_carrier = np.log10(link.distance_3d_m), np.log10(link.height_m), np.log10(link.carrier_ghz)
    if link.height_m > _AERIAL_ABOVE_M:
        los_db = np.maximum(free_space_db(link), (22.25 - 0.5 * log_height) * log_distance + (30.9 + 20.0 * log_carrier))
        nlos_db = (43.2 - 7.6 * log_height) * log_distance + (32.4 + 20.0 * log_carrier)
    else:
        los_db = two_slopes_db(link, intercept_db=32.4, slope=21.0, far_correction=9.5)
        nlos_db = 35.3 * log_distance + (22.4 + 21.3 * log_carrier - 0.3 * (link.height_m - 1.5))
    return los_db, np.maximum(los_db, nlos_db)


def _shadow_std_db(link: Link) -> Losses:
    """Table B-3."""
    if link.height_m > _AERIAL_ABOVE_M:
        return np.full(1, max(5.0 * np.exp(-0.01 * link.height_m), 2.0)), np.full(1, 8.0)
    return np.full(1, 4.0), np.full(1, 7.82)


# Correlation distances: TR 38.901 Table 7.5-6 (shadowing) and Table 7.6.3.1-2 (LOS state).
UMI_AV = Environment(_los_probability, _path_loss_db, _shadow_std_db, 10.0, 13.0, 50.0)
