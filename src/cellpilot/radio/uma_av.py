"""Urban macro with aerial vehicles: 3GPP TR 36.777 Annex B, below 22.5 m the UMa of TR 38.901. Fitted for 25 m masts."""

import numpy as np

from cellpilot.radio import fast
from cellpilot.radio.environment import Environment, Link, Losses, carrier_db, decaying_probability, two_slopes_db
from cellpilot.radio.ranges import FloatArray

_AERIAL_ABOVE_M = 22.5
_LOS_ONLY_ABOVE_M = 100.0


def _los_probability(distance_2d_m: FloatArray, height_m: float) -> FloatArray:
    """Table B-1; at and below 22.5 m TR 38.901 Table 7.4.2-1."""
    if height_m > _LOS_ONLY_ABOVE_M:
        return np.ones(1)
    if height_m > _AERIAL_ABOVE_M:
        log_height = np.log10(height_m)
        return decaying_probability(distance_2d_m, max(460.0 * log_height - 700.0, 18.0), 4300.0 * log_height - 3800.0)
    above_13_m = max(height_m - 13.0, 0.0)
    raised = 1.0 + (above_13_m / 10.0) ** 1.5 * 1.25 * (distance_2d_m / 100.0) ** 3 * fast.exp(distance_2d_m / -150.0)
    ground = np.where(distance_2d_m <= 18.0, 1.0, decaying_probability(distance_2d_m, 18.0, 63.0) * raised)
    # The product exceeds 1 by up to 0.6 % just beyond 18 m for heights near 22.5 m.
    return np.minimum(ground, 1.0)


def _path_loss_db(link: Link) -> Losses:
    """Table B-2; at and below 22.5 m TR 38.901 Table 7.4.1-1."""
    log_distance, log_carrier = np.log10(link.distance_3d_m), np.log10(link.carrier_ghz)
    if link.height_m <= _AERIAL_ABOVE_M:
        los_db = two_slopes_db(link, intercept_db=28.0, slope=22.0, far_correction=9.0)
        nlos_db = 13.54 + 39.08 * log_distance + 20.0 * log_carrier - 0.6 * (link.height_m - 1.5)
        return los_db, np.maximum(los_db, nlos_db)
    los_db = 22.0 * log_distance + (28.0 + 20.0 * log_carrier)
    if link.height_m > _LOS_ONLY_ABOVE_M:
        return los_db, None
    # The aerial NLOS line has no max() with LOS: close to the mast it falls below it, and the table says so.
    return los_db, (46.0 - 7.0 * np.log10(link.height_m)) * log_distance + (carrier_db(link) - 17.5)


def _shadow_std_db(link: Link) -> Losses:
    """Table B-3."""
    los_db = 4.0 if link.height_m <= _AERIAL_ABOVE_M else 4.64 * np.exp(-0.0066 * link.height_m)
    return np.full(1, los_db), np.full(1, 6.0) if link.height_m <= _LOS_ONLY_ABOVE_M else None


# Correlation distances: TR 38.901 Table 7.5-6 (shadowing) and Table 7.6.3.1-2 (LOS state).
UMA_AV = Environment(_los_probability, _path_loss_db, _shadow_std_db, 37.0, 50.0, 50.0)
