"""The place where a drone hovered: many samples of one spot that would pass for a measured area."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor, to_local

HOVER_RADIUS_M = 25.0
"""Radius of the disc that is searched for; a hovering drone with a satellite position stays within it."""

HOVER_SHARE = 0.05
"""A hover holds more than this share of all samples: a straight pass through the disc takes a few seconds."""

HOVER_CROWDING = 5.0
"""... and more than this many times the samples of the median disc, so that a short log is not taken for one."""


@dataclass(frozen=True)
class Mask:
    """A disc whose samples are left out: WGS84 centre [deg], radius [m]. `InputError` for an impossible one."""

    latitude_deg: float
    longitude_deg: float
    radius_m: float

    def __post_init__(self) -> None:
        Anchor(self.latitude_deg, self.longitude_deg)
        if not np.isfinite(self.radius_m) or self.radius_m <= 0:
            raise InputError(f"the mask's radius is {self.radius_m:g} m; expected more than 0 (or no mask)")

    def holds(self, latitude_deg: FloatArray, longitude_deg: FloatArray) -> NDArray[np.bool_]:
        """Which positions `[n]` lie within the disc, its edge included."""
        x_m, y_m = to_local(latitude_deg, longitude_deg, Anchor(self.latitude_deg, self.longitude_deg))
        return np.asarray(np.hypot(x_m, y_m) <= self.radius_m)


def densest_disc(latitude_deg: FloatArray, longitude_deg: FloatArray) -> tuple[Mask, bool]:
    """The disc of 25 m around the sample position with most samples in it, and whether that is a hover.

    Ties go to the southernmost, then westernmost position, so the order of the samples `[n]` changes nothing. It is a
    hover if it holds more than 5 % of all samples and more than 5 times as many as the median disc.
    """
    places, samples = np.unique(np.stack([latitude_deg, longitude_deg], axis=-1), axis=0, return_counts=True)
    middle = places[len(places) // 2]
    local_m = np.stack(to_local(places[:, 0], places[:, 1], Anchor(float(middle[0]), float(middle[1]))), axis=-1)
    # Samples are counted by place: a hover repeats positions, and the search need not visit them one by one.
    near = cKDTree(local_m).query_ball_point(local_m, HOVER_RADIUS_M)
    held = np.array([samples[indices].sum() for indices in near])
    best = int(held.argmax())
    hovering = held[best] > HOVER_SHARE * samples.sum() and held[best] > HOVER_CROWDING * np.median(held)
    return Mask(float(places[best, 0]), float(places[best, 1]), HOVER_RADIUS_M), bool(hovering)
