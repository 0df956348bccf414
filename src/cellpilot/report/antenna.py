"""Polar plots of an antenna's two cuts."""

import numpy as np
from matplotlib.figure import Figure
from matplotlib.projections.polar import PolarAxes

from cellpilot.radio import Antenna
from cellpilot.report.style import BLUE, VERMILION, as_drawn, drawing_settings

DEPTH_DB = 40.0
"""What lies deeper below the peak is drawn in the middle."""

RINGS_DB = np.array([30.0, 20.0, 10.0, 3.0])
"""Depths below the peak that have a ring and a label."""


def draw_antenna(antenna: Antenna) -> Figure:
    """Gain [dBi] around the antenna in the horizon, and in the vertical plane through boresight; save it with `save_figure`."""
    with drawing_settings():
        figure = Figure(figsize=(6.3, 3.7), layout="constrained")
        azimuth_deg, zenith_deg = _peak(antenna)
        angle_deg = np.arange(-180.0, 180.5, 0.5)
        horizontal_dbi = antenna.gain_dbi(angle_deg, zenith_deg)
        # Up over the front (0 to 180 degrees from straight up), and back up behind.
        from_above_deg = np.abs(angle_deg)
        front, back = (antenna.gain_dbi(side, from_above_deg) for side in (azimuth_deg, azimuth_deg + 180.0))
        vertical_dbi = np.where(angle_deg >= 0, front, back)
        peak_dbi = float(max(horizontal_dbi.max(), vertical_dbi.max()))
        axes: PolarAxes = figure.add_subplot(1, 2, 1, projection="polar")  # type: ignore[assignment]
        # Seen from above with boresight up: counter-clockwise angles run to the left.
        axes.set_theta_zero_location("N")
        _curve(axes, np.radians(angle_deg), horizontal_dbi, peak_dbi, BLUE)
        axes.set_thetagrids(range(0, 360, 45), ["0°", "-45°", "-90°", "-135°", "180°", "135°", "90°", "45°"])
        axes.set_title(f"from above, {zenith_deg - 90:g}° below the horizon\n(clockwise from boresight)")
        axes = figure.add_subplot(1, 2, 2, projection="polar")  # type: ignore[assignment]
        axes.set_theta_zero_location("N")
        axes.set_theta_direction(-1)
        _curve(axes, np.radians(angle_deg), vertical_dbi, peak_dbi, VERMILION)
        axes.set_thetagrids(range(0, 360, 45), ["up", "45°", "0°", "-45°", "down", "", "behind", ""])
        axes.set_title(f"from the side, {0.0 - azimuth_deg:g}° clockwise from boresight\n(above the horizon)")
        name = as_drawn(getattr(antenna, "name", "") or type(antenna).__name__)
        figure.suptitle(f"{name}: gain [dBi], peak {peak_dbi:.1f} dBi")
    return figure


def _peak(antenna: Antenna) -> tuple[float, float]:
    """Azimuth and zenith of the greatest gain, to a degree; the nearest to boresight and horizon of several."""
    azimuth_deg = np.array(sorted(range(-180, 180), key=abs), dtype=np.float64)
    zenith_deg = np.array(sorted(range(181), key=lambda z: abs(z - 90)), dtype=np.float64)
    gain_dbi = antenna.gain_dbi(azimuth_deg[:, None], zenith_deg)
    best = np.unravel_index(int((gain_dbi >= gain_dbi.max() - 1e-9).argmax()), gain_dbi.shape)
    return float(azimuth_deg[best[0]]), float(zenith_deg[best[1]])


def _curve(axes: PolarAxes, angle_rad: np.ndarray, gain_dbi: np.ndarray, peak_dbi: float, colour: str) -> None:
    low_dbi, rings_dbi = peak_dbi - DEPTH_DB, peak_dbi - RINGS_DB
    shown_dbi = np.maximum(gain_dbi, low_dbi)
    axes.plot(angle_rad, shown_dbi, color=colour)
    axes.set_rlim(low_dbi, peak_dbi + 1.0)
    axes.set_rticks(rings_dbi.tolist(), labels=[])
    angle = _clear_angle(angle_rad, shown_dbi, rings_dbi)
    # The labels of an axis lie under the curve; these lie above it.
    for ring_dbi in rings_dbi:
        box = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}
        axes.text(angle, ring_dbi, f"{ring_dbi:.0f}", fontsize=8, ha="center", va="center", zorder=4, bbox=box)


def _clear_angle(angle_rad: np.ndarray, gain_dbi: np.ndarray, rings_dbi: np.ndarray) -> float:
    """The direction between the spokes [rad] in which the curve keeps farthest from the labels of the rings."""
    candidates = np.radians(np.arange(22.5, 360.0, 45.0))
    off_rad = np.abs((angle_rad - candidates[:, None] + np.pi) % (2 * np.pi) - np.pi)
    radius_db = DEPTH_DB - RINGS_DB
    # Towards the middle a label spans more of the circle: 7 degrees to each side at the outermost ring.
    half_width_rad = np.radians(7.0) * radius_db.max() / radius_db
    distance_db = np.abs(gain_dbi - rings_dbi[:, None])
    near = off_rad[:, None, :] <= half_width_rad[:, None]
    return float(candidates[np.where(near, distance_db, np.inf).min(axis=(1, 2)).argmax()])
