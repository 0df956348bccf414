"""Deployments: the hexagonal layout and what is refused."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot.errors import InputError, RangeError
from cellpilot.radio import ColumnAntenna, Deployment, hexagonal_deployment


def test_default_is_seven_sites_of_three_sectors() -> None:
    deployment = hexagonal_deployment()
    assert deployment.n_sectors == 21
    np.testing.assert_array_equal(deployment.site, np.repeat(np.arange(7), 3))
    np.testing.assert_array_equal(deployment.boresight_deg, np.tile([30.0, 150.0, 270.0], 7))
    x_m, y_m = deployment.x_m[::3], deployment.y_m[::3]
    assert (x_m[0], y_m[0]) == (0.0, 0.0)
    np.testing.assert_allclose(np.hypot(x_m[1:], y_m[1:]), 500.0)
    np.testing.assert_allclose(np.degrees(np.arctan2(y_m[1:], x_m[1:])) % 360, np.arange(0, 360, 60), atol=1e-9)
    np.testing.assert_allclose(deployment.interference.noise_dbm, np.full(21, -95.0))
    assert deployment.interference.n_subcarriers.tolist() == [600] * 21


@given(st.integers(0, 5))
def test_rings_fill_the_lattice(rings: int) -> None:
    deployment = hexagonal_deployment(rings, 500.0, boresights_deg=(0.0,))
    places = deployment.x_m + 1j * deployment.y_m
    assert len(places) == 1 + 3 * rings * (rings + 1)
    if rings:
        apart = np.abs(places[:, None] - places) + 1e9 * np.eye(len(places))
        np.testing.assert_allclose(apart.min(axis=1), 500.0)
        outer = places[-6 * rings :]
        assert outer[0] == pytest.approx(500.0 * rings)
        assert (np.diff(np.unwrap(np.angle(outer))) > 0).all()


def test_one_value_or_one_per_sector() -> None:
    loads = np.linspace(0, 1, 21)
    antennas = [ColumnAntenna(8, 0.8, tilt) for tilt in range(21)]
    deployment = hexagonal_deployment(load=loads, antenna=antennas, power_dbm=loads + 40)
    np.testing.assert_array_equal(deployment.load, loads)
    assert deployment.antenna == tuple(antennas)
    assert not deployment.load.flags.writeable
    loads[0] = 0.7
    assert deployment.load[0] == 0.0


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"load": 1.2}, RangeError, "load is 1.2; expected 0..1$"),
        ({"load": [1.0, 1.0]}, InputError, r"load has shape \(2,\); expected one value or 21"),
        ({"base_height_m": 500.0}, RangeError, "mast height is 500 m"),
        ({"carrier_hz": 2.0}, RangeError, "carrier is 2 Hz"),
        ({"bandwidth_hz": 7e6}, InputError, "bandwidth is 7 MHz; expected one of 1.4, 3, 5, 10, 15, 20 MHz"),
        ({"noise_figure_db": -1.0}, RangeError, "noise figure is -1 dB; expected at least 0 dB"),
        ({"rings": -1}, InputError, "rings is -1"),
        ({"inter_site_distance_m": 0.0}, InputError, "inter-site distance is 0 m"),
        ({"boresights_deg": ()}, InputError, "boresights_deg is empty"),
        ({"power_dbm": np.nan}, RangeError, "power is nan dBm"),
        ({"antenna": [ColumnAntenna(8, 0.8, 0.0)]}, InputError, "1 antennas for 21 sectors"),
        ({"antenna": 8.0}, InputError, "no gain_dbi"),
    ],
)
def test_bad_deployments_are_refused(change: dict, error: type, message: str) -> None:
    with pytest.raises(error, match=message):
        hexagonal_deployment(**change)


def test_sites_are_whole_numbers_and_sectors_exist() -> None:
    rest = (25.0, 0.0, 48.0, 1.0, ColumnAntenna(8, 0.8, 7.0))
    with pytest.raises(InputError, match="site is"):
        Deployment([0.0], [0.0], *rest, site=[0.5], carrier_hz=2e9, bandwidth_hz=10e6, noise_figure_db=9.0)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no sectors"):
        Deployment([], [], *rest, site=0, carrier_hz=2e9, bandwidth_hz=10e6, noise_figure_db=9.0)  # type: ignore[arg-type]
