"""An antenna known by its horizontal and vertical cut, as manufacturers publish it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.errors import InputError
from cellpilot.radio import fast
from cellpilot.radio.antenna import to_panel
from cellpilot.radio.ranges import FloatArray, as_floats, check_range
from cellpilot.radio.settings import COLUMN


@dataclass(frozen=True, eq=False)
class PatternAntenna:
    """Gain = peak - (horizontal cut + vertical cut): the usual approximation from two cuts, good near the main planes.

    Behind and beside the antenna, off both planes, the real pattern can differ by 10 dB and more: two cuts do not say.
    Each cut is taken relative to its own least attenuation, so that the peak of the pattern is `peak_gain_dbi`.
    Positive tilts point downwards. `electrical_tilt_deg` shifts the vertical cut all round, on top of what the cut contains;
    `mechanical_tilt_deg` turns the panel. `InputError` for cuts that are not 360 finite values, 0 or more.
    """

    peak_gain_dbi: float
    """Gain in the direction of least attenuation [dBi]."""
    horizontal_db: FloatArray
    """Attenuation `[360]` [dB] at 0, 1, ... 359 degrees clockwise from boresight, seen from above."""
    vertical_db: FloatArray
    """Attenuation `[360]` [dB] at 0, 1, ... 359 degrees below the horizon: 90 is straight down, 270 straight up."""
    electrical_tilt_deg: float = 0.0
    """Further electrical downtilt [deg, -90..90]."""
    mechanical_tilt_deg: float = COLUMN.mechanical_tilt_deg
    """Tilt of the panel below the horizon [deg, -90..90]."""
    name: str = ""

    def __post_init__(self) -> None:
        check_range(self.peak_gain_dbi, "antenna gain", -np.inf, np.inf, "dBi")
        check_range(self.electrical_tilt_deg, "electrical tilt", -90.0, 90.0, "deg")
        check_range(self.mechanical_tilt_deg, "mechanical tilt", -90.0, 90.0, "deg")
        for cut in ("horizontal_db", "vertical_db"):
            object.__setattr__(self, cut, _checked_cut(getattr(self, cut), cut.removesuffix("_db")))

    def gain_dbi(self, azimuth_deg: ArrayLike, zenith_deg: ArrayLike) -> FloatArray:
        """Gain [dBi] in the broadcast shape of the arguments, linear in dB between the degrees of the cuts.

        Azimuth from boresight [deg, counter-clockwise, any]; zenith [deg, 0..180, 90 = horizon], `RangeError` outside.
        """
        azimuth_deg = check_range(azimuth_deg, "azimuth", -np.inf, np.inf, "deg")
        zenith_deg = check_range(zenith_deg, "zenith", 0.0, 180.0, "deg")
        if self.mechanical_tilt_deg != 0.0:
            azimuth_deg, zenith_deg = to_panel(azimuth_deg, zenith_deg, self.mechanical_tilt_deg)
        horizontal_db = _at(self.horizontal_db, -azimuth_deg)
        # The vertical cut of the front serves all round: what lies behind is in the horizontal cut already.
        vertical_db = _at(self.vertical_db, zenith_deg - 90.0 - self.electrical_tilt_deg)
        return np.asarray(self.peak_gain_dbi - horizontal_db - vertical_db)

    @property
    def downtilt_deg(self) -> float:
        """Downtilt of the vertical cut's peak in the front half [deg], further electrical tilt included."""
        below_deg = np.concatenate([np.arange(0, 91), np.arange(-90, 0)])
        return float(below_deg[self.vertical_db[below_deg].argmin()]) + self.electrical_tilt_deg


def _checked_cut(values: ArrayLike, name: str) -> FloatArray:
    cut = as_floats(values, f"the {name} cut")
    if cut.shape != (360,) or not np.isfinite(cut).all() or (cut < 0).any():
        raise InputError(f"the {name} cut has shape {cut.shape}; expected 360 attenuations, 0 dB or more, one for each degree")
    cut = cut.copy()
    cut.flags.writeable = False
    return cut


def _at(cut_db: NDArray[np.float64], angle_deg: FloatArray) -> FloatArray:
    """The cut at any angle, less its own least attenuation."""
    turned_deg = fast.wrap_deg(angle_deg) + 360.0
    degree = turned_deg.astype(np.int64)
    # The table runs from 180 to 540 degrees and one beyond, so that no angle needs another wrap.
    table_db = np.concatenate([cut_db[180:], cut_db, cut_db[:2]]) - cut_db.min()
    start_db = table_db[degree - 180]
    return np.asarray(start_db + (turned_deg - degree) * (table_db[degree - 179] - start_db))
