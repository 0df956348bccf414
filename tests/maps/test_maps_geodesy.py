"""Degrees and metres against published lengths of a degree, and back again."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, to_degrees, to_local
from cellpilot.maps.geodesy import metres_per_degree


@pytest.mark.parametrize(
    # Lengths of a degree on WGS84, rounded to a metre.
    ("latitude_deg", "east_m", "north_m"),
    [
        (0, 111320, 110574),
        (15, 107550, 110649),
        (30, 96486, 110852),
        (45, 78847, 111132),
        (60, 55800, 111412),
        (75, 28902, 111618),
    ],
)
def test_length_of_a_degree(latitude_deg: float, east_m: float, north_m: float) -> None:
    assert metres_per_degree(latitude_deg) == pytest.approx((east_m, north_m), abs=0.6)
    assert metres_per_degree(-latitude_deg) == metres_per_degree(latitude_deg)


@settings(deadline=None)
@given(
    st.builds(Anchor, st.floats(-89, 89), st.floats(-180, 180)),
    st.floats(-5000, 5000),
    st.floats(-5000, 5000),
)
def test_there_and_back(anchor: Anchor, x_m: float, y_m: float) -> None:
    latitude_deg, longitude_deg = to_degrees(x_m, y_m, anchor)
    assert -180 <= longitude_deg <= 180
    assert to_local(latitude_deg, longitude_deg, anchor) == pytest.approx((x_m, y_m), abs=1e-6)


def test_axes_and_anchor() -> None:
    anchor = Anchor(47.0, 8.0)
    assert to_local(47.0, 8.0, anchor) == (0.0, 0.0)
    x_m, y_m = to_local([47.001, 47.0], [8.0, 8.001], anchor)
    assert x_m[0] == 0
    assert y_m[0] > 0
    assert x_m[1] > 0
    assert y_m[1] == 0


def test_error_stays_within_what_the_module_states() -> None:
    anchor = Anchor(50.0, 0.0)
    for side_m, stated_m in ((1000.0, 0.2), (5000.0, 5.0)):
        latitude_deg, longitude_deg = to_degrees(side_m, side_m, anchor)
        true_east_m = float(longitude_deg) * metres_per_degree(float(latitude_deg))[0]
        assert abs(true_east_m - side_m) < stated_m


def test_the_short_way_over_the_antimeridian() -> None:
    x_m, _ = to_local(0.0, -179.999, Anchor(0.0, 179.999))
    assert x_m == pytest.approx(0.002 * 111319.49, rel=1e-6)


@pytest.mark.parametrize("latitude_deg", [89.5, -90.0, np.nan, 101.77])
def test_impossible_anchor(latitude_deg: float) -> None:
    with pytest.raises(InputError, match="latitude"):
        Anchor(latitude_deg, 0.0)
    with pytest.raises(InputError, match="longitude"):
        Anchor(0.0, 181.0)
    with pytest.raises(InputError, match="altitude"):
        Anchor(0.0, 0.0, np.inf)
