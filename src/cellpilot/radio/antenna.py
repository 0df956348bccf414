"""Antenna gain towards a direction: the 3GPP element, and a column of elements with electrical and mechanical tilt."""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.radio import fast
from cellpilot.radio.ranges import FloatArray, as_floats, check_range
from cellpilot.radio.settings import COLUMN, ColumnSettings
from cellpilot.units import to_db

ELEMENT_PEAK_DBI = 8.0
ELEMENT_BEAMWIDTH_DEG = 65.0
ELEMENT_MAX_ATTENUATION_DB = 30.0


class Antenna(Protocol):
    """Anything that knows its gain can hang in a sector; keep it immutable."""

    def gain_dbi(self, azimuth_deg: ArrayLike, zenith_deg: ArrayLike) -> FloatArray:
        """Gain [dBi]; azimuth from boresight, counter-clockwise; zenith 0 up, 90 horizon; broadcast shape."""
        ...


def element_gain_dbi(azimuth_deg: ArrayLike, zenith_deg: ArrayLike) -> FloatArray:
    """Gain of one antenna element [dBi] in the broadcast shape of the arguments, -22..8.

    Azimuth from boresight [deg, any, wrapped]; zenith [deg, 0..180, 90 = horizon], `RangeError` outside.

    Source: 3GPP TR 38.901 Table 7.3-1. The pattern is not normalised to be lossless, as in the source.
    """
    azimuth_deg = check_range(azimuth_deg, "azimuth", -np.inf, np.inf, "deg")
    zenith_deg = check_range(zenith_deg, "zenith", 0.0, 180.0, "deg")
    azimuth_deg = fast.wrap_deg(azimuth_deg)
    vertical_db = np.minimum(12.0 * ((zenith_deg - 90.0) / ELEMENT_BEAMWIDTH_DEG) ** 2, ELEMENT_MAX_ATTENUATION_DB)
    horizontal_db = np.minimum(12.0 * (azimuth_deg / ELEMENT_BEAMWIDTH_DEG) ** 2, ELEMENT_MAX_ATTENUATION_DB)
    return np.asarray(ELEMENT_PEAK_DBI - np.minimum(vertical_db + horizontal_db, ELEMENT_MAX_ATTENUATION_DB))


@dataclass(frozen=True)
class ColumnAntenna:
    """Vertical column of equal elements, fed with one phase step (electrical tilt), on a panel (mechanical tilt).

    Positive tilts point downwards. Mechanical tilt turns the whole panel: to the front it lowers the beam, to the back it
    raises it, at the sides it does nothing; electrical tilt lowers the beam all round.
    """

    n_vertical: int
    """Number of elements, at least 1."""
    spacing_wavelengths: float
    """Distance between neighbouring elements [wavelengths], above 0."""
    electrical_tilt_deg: float
    """Tilt of the array factor below the panel's own horizon [deg, -90..90]."""
    mechanical_tilt_deg: float = COLUMN.mechanical_tilt_deg
    """Tilt of the panel below the horizon [deg, -90..90]."""
    array_factor_floor_db: float = COLUMN.array_factor_floor_db
    """Depth at which nulls are filled [dB relative to one element]."""

    @classmethod
    def of(cls, settings: ColumnSettings) -> "ColumnAntenna":
        """The column of the settings."""
        return cls(
            settings.antenna_elements,
            settings.antenna_spacing_wavelengths,
            settings.electrical_tilt_deg,
            settings.mechanical_tilt_deg,
            settings.array_factor_floor_db,
        )

    def __post_init__(self) -> None:
        if not isinstance(self.n_vertical, int | np.integer) or self.n_vertical < 1:
            raise InputError(f"n_vertical is {self.n_vertical!r}; expected a whole number of elements, at least 1")
        spacing = as_floats(self.spacing_wavelengths, "spacing_wavelengths")
        if not (np.isfinite(spacing) and spacing > 0):
            raise InputError(f"spacing_wavelengths is {self.spacing_wavelengths!r}; expected a number above 0")
        check_range(self.electrical_tilt_deg, "electrical tilt", -90.0, 90.0, "deg")
        check_range(self.mechanical_tilt_deg, "mechanical tilt", -90.0, 90.0, "deg")
        check_range(self.array_factor_floor_db, "array-factor floor", -np.inf, np.inf, "dB")

    def gain_dbi(self, azimuth_deg: ArrayLike, zenith_deg: ArrayLike) -> FloatArray:
        """Gain [dBi] in the broadcast shape of the arguments; at most about 8 + 10 log10(n_vertical).

        Azimuth from boresight [deg, counter-clockwise, any]; zenith [deg, 0..180, 90 = horizon], `RangeError` outside.

        Source: element TR 38.901 Table 7.3-1; column weights exp(-j 2 pi (m-1) d cos(tilt zenith)) / sqrt(M) as in TR 36.873
        clause 7.1; mechanical tilt TR 38.901 clause 7.1.4 (downtilt only).
        """
        azimuth_deg = check_range(azimuth_deg, "azimuth", -np.inf, np.inf, "deg")
        zenith_deg = check_range(zenith_deg, "zenith", 0.0, 180.0, "deg")
        if self.mechanical_tilt_deg != 0.0:
            azimuth_deg, zenith_deg = to_panel(azimuth_deg, zenith_deg, self.mechanical_tilt_deg)
        array_factor_db = np.maximum(to_db(self._array_factor(zenith_deg)), self.array_factor_floor_db)
        return np.asarray(element_gain_dbi(azimuth_deg, zenith_deg) + array_factor_db)

    def _array_factor(self, zenith_deg: FloatArray) -> FloatArray:
        """Power of the column relative to one element, 0..M, towards a zenith angle of the panel."""
        # The geometric sum over the elements is sin(M u)/sin(u); at the main and grating lobes, sin(u) = 0, it is M.
        tilt_cosine = -np.sin(np.radians(self.electrical_tilt_deg))
        _, cosine = fast.sine_cosine(np.radians(zenith_deg))
        half_phase = np.pi * self.spacing_wavelengths * (cosine - tilt_cosine)
        one = self.n_vertical * fast.squared_sine(half_phase)
        at_lobe = one < 1e-14
        return np.where(
            at_lobe, float(self.n_vertical), fast.squared_sine(self.n_vertical * half_phase) / np.where(at_lobe, 1.0, one)
        )


def to_panel(azimuth_deg: FloatArray, zenith_deg: FloatArray, tilt_deg: float) -> tuple[FloatArray, FloatArray]:
    """Direction as the panel sees it: rotation about the horizontal axis across boresight, TR 38.901 clause 7.1.4."""
    tilt = np.radians(tilt_deg)
    azimuth_sine, azimuth_cosine = fast.sine_cosine(np.radians(azimuth_deg))
    zenith_sine, up = fast.sine_cosine(np.radians(zenith_deg))
    forward, left = azimuth_cosine * zenith_sine, azimuth_sine * zenith_sine
    panel_up = np.clip(forward * np.sin(tilt) + up * np.cos(tilt), -1.0, 1.0)
    panel_forward = forward * np.cos(tilt) - up * np.sin(tilt)
    return np.degrees(np.arctan2(left, panel_forward)), np.degrees(np.arccos(panel_up))
