"""Between WGS84 latitude and longitude and local metres around an anchor: x east, y north.

Both axes are scaled by the ellipsoid's radii of curvature at the anchor: north by the meridian radius, east by the
radius of the parallel. Against the true geodesic the error grows as east * north * tan(latitude) / 6371 km: at 50
degrees latitude 0.2 m at 1 km east and 1 km north, 5 m at 5 km and 5 km. Maps of some kilometres are what it is for.
"""

from dataclasses import dataclass
from math import cos, isfinite, radians, sin, sqrt

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError

SEMI_MAJOR_AXIS_M = 6378137.0
"""Equatorial radius of WGS84 [m] (NIMA TR8350.2, table 3.1)."""

FLATTENING = 1 / 298.257223563
"""Flattening of WGS84 (NIMA TR8350.2, table 3.1)."""

MEAN_RADIUS_KM = 6371.0

MAX_LATITUDE_DEG = 89.0
"""Beyond this an east metre spans so many degrees that the tangent plane is no map any more."""


@dataclass(frozen=True)
class Anchor:
    """Where x = y = z = 0 lies on Earth: WGS84 degrees, and the altitude of z = 0 in the map's datum [m].

    `InputError` outside -89 to 89 degrees latitude, -180 to 180 degrees longitude, or for an infinite altitude.
    """

    latitude_deg: float
    longitude_deg: float
    altitude_m: float = 0.0

    def __post_init__(self) -> None:
        if not abs(self.latitude_deg) <= MAX_LATITUDE_DEG:
            raise InputError(
                f"the anchor's latitude is {self.latitude_deg:g}; expected -{MAX_LATITUDE_DEG:g} to {MAX_LATITUDE_DEG:g} deg"
                " (is it exchanged with the longitude?)"
            )
        if not abs(self.longitude_deg) <= 180:
            raise InputError(f"the anchor's longitude is {self.longitude_deg:g}; expected -180 to 180 deg")
        if not isfinite(self.altitude_m):
            raise InputError(f"the anchor's altitude is {self.altitude_m:g}; expected a finite number of metres")


def metres_per_degree(latitude_deg: float) -> tuple[float, float]:
    """Metres per degree of longitude and of latitude on the WGS84 ellipsoid at a latitude [deg]."""
    eccentricity_squared = FLATTENING * (2 - FLATTENING)
    sine = sin(radians(latitude_deg))
    root = sqrt(1 - eccentricity_squared * sine**2)
    normal_radius_m = SEMI_MAJOR_AXIS_M / root
    meridian_radius_m = SEMI_MAJOR_AXIS_M * (1 - eccentricity_squared) / root**3
    return radians(1) * normal_radius_m * cos(radians(latitude_deg)), radians(1) * meridian_radius_m


def to_local(latitude_deg: ArrayLike, longitude_deg: ArrayLike, anchor: Anchor) -> tuple[FloatArray, FloatArray]:
    """East and north of the anchor [m], in the shape of the degrees given; the short way round the antimeridian."""
    east_m, north_m = metres_per_degree(anchor.latitude_deg)
    # Only what crosses the antimeridian is wrapped: the modulo would cost the other differences their last digits.
    difference_deg = np.asarray(longitude_deg, dtype=np.float64) - anchor.longitude_deg
    turn_deg = np.where(difference_deg > 180, 360.0, np.where(difference_deg < -180, -360.0, 0.0))
    north_deg = np.asarray(latitude_deg, dtype=np.float64) - anchor.latitude_deg
    return np.asarray((difference_deg - turn_deg) * east_m), np.asarray(north_deg * north_m)


def to_degrees(x_m: ArrayLike, y_m: ArrayLike, anchor: Anchor) -> tuple[FloatArray, FloatArray]:
    """Latitude and longitude [deg] of local metres: the inverse of `to_local`, longitude within -180 to 180."""
    east_m, north_m = metres_per_degree(anchor.latitude_deg)
    latitude_deg = anchor.latitude_deg + np.asarray(y_m, dtype=np.float64) / north_m
    longitude_deg = anchor.longitude_deg + np.asarray(x_m, dtype=np.float64) / east_m
    turn_deg = np.where(longitude_deg > 180, 360.0, np.where(longitude_deg < -180, -360.0, 0.0))
    return np.asarray(latitude_deg), np.asarray(longitude_deg - turn_deg)


def farthest_from_the_rest(latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[int, float]:
    """The place farthest from the median place, and its great-circle distance from there [km]."""
    latitude, longitude = np.radians(latitude_deg), np.radians(longitude_deg)
    # As unit vectors, so that neither the antimeridian nor a few strays move the middle.
    places = np.stack([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)], axis=-1)
    middle = np.median(places, axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    half_chord = np.linalg.norm(places - middle, axis=-1) / 2
    farthest = int(half_chord.argmax())
    return farthest, float(2 * MEAN_RADIUS_KM * np.arcsin(min(half_chord[farthest], 1.0)))
