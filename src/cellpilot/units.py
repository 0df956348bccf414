"""Conversions between linear and logarithmic power, and the thermal-noise constant."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

THERMAL_NOISE_DBM_HZ = -174.0
"""Thermal noise density at 290 K [dBm/Hz]."""


def to_db(ratio: ArrayLike) -> NDArray[np.float64]:
    """10 log10 of a power ratio; 0 becomes -inf."""
    with np.errstate(divide="ignore"):
        return np.asarray(10.0 * np.log10(np.asarray(ratio, dtype=np.float64)))


def from_db(level_db: ArrayLike) -> NDArray[np.float64]:
    """Power ratio of a level in dB (or milliwatt of a level in dBm)."""
    # exp2 is some twenty times as fast as a power of 10 (see radio/fast.py).
    return np.asarray(np.exp2(np.asarray(level_db, dtype=np.float64) * (np.log2(10.0) / 10.0)))
