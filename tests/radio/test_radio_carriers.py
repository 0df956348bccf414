"""Sectors of one site on several carriers and bandwidths: what each has of its own, and what they share."""

import dataclasses

import numpy as np
import pytest

from cellpilot.radio import Deployment, hexagonal_deployment, path_loss_db, received_power_dbm, simulate

POINTS = (np.array([60.0, -200.0, 400.0]), np.array([-35.0, 120.0, 10.0]), np.array([20.0, 45.0, 60.0]))


def pair(**changes: object) -> Deployment:
    """Two equal sectors of one site, apart in what is given."""
    return hexagonal_deployment(rings=0, boresights_deg=(0.0, 0.0), **changes)  # type: ignore[arg-type]


def test_each_carrier_has_its_own_path_loss() -> None:
    low_dbm, high_dbm = received_power_dbm(pair(carrier_hz=[0.8e9, 2.6e9]), *POINTS, los="nlos")
    distance_m = np.hypot(*POINTS[:2])
    low_db, high_db = (path_loss_db("UMa-AV", hz, distance_m, 25.0, POINTS[2])[1] for hz in (0.8e9, 2.6e9))
    np.testing.assert_allclose(low_dbm - high_dbm, high_db - low_db, rtol=0, atol=1e-9)
    assert (high_db - low_db > 9).all()


@pytest.mark.parametrize("los", ["los", "nlos", "sampled"])
def test_carriers_of_one_site_share_its_shadowing_and_sight(los: str) -> None:
    apart = pair(carrier_hz=[1.8e9, 2.6e9])
    shaded_dbm = received_power_dbm(apart, *POINTS, los=los, shadowing_seed=3)  # type: ignore[arg-type]
    excess_db = received_power_dbm(apart, *POINTS, los="los") - shaded_dbm
    # Losses in sight and out of it grow alike with the carrier.
    np.testing.assert_allclose(excess_db[0], excess_db[1], rtol=0, atol=1e-9)
    assert np.abs(excess_db).max() > 1


def test_noise_is_that_of_the_own_bandwidth() -> None:
    mixed = pair(bandwidth_hz=[10e6, 20e6], noise_figure_db=7.0)
    expected = -174 + 10 * np.log10([10e6, 20e6]) + 7
    np.testing.assert_allclose(mixed.interference.noise_dbm, expected, rtol=0, atol=1e-9)
    # The wide sector alone, on a carrier of its own: signal over noise.
    wide = pair(bandwidth_hz=[10e6, 20e6], carrier_hz=[2e9, 2.5e9], power_dbm=[-100.0, 48.0], noise_figure_db=7.0)
    got = simulate(wide, *POINTS)
    assert (got.serving_sector == 1).all()
    np.testing.assert_allclose(got.sinr_db, got.wideband_power_dbm - expected[1], rtol=0, atol=1e-6)


def test_rsrp_is_that_of_the_own_subcarriers() -> None:
    got = simulate(pair(bandwidth_hz=[5e6, 20e6], power_dbm=[10.0, 48.0]), *POINTS, every_sector=True)
    power_dbm = received_power_dbm(pair(bandwidth_hz=[5e6, 20e6], power_dbm=[10.0, 48.0]), *POINTS)
    assert (got.serving_sector == 1).all()
    assert got.sector_rsrp_dbm is not None
    np.testing.assert_allclose(got.rsrp_dbm, power_dbm[1] - 10 * np.log10(1200), rtol=0, atol=1e-9)
    np.testing.assert_allclose(got.sector_rsrp_dbm, power_dbm - 10 * np.log10([[300], [1200]]), rtol=0, atol=1e-9)


def test_masts_of_different_heights_see_a_point_under_their_own_angle() -> None:
    heights_m = np.repeat([15.0, 25.0, 40.0, 60.0, 25.0, 30.0, 35.0], 3)
    mixed = dataclasses.replace(hexagonal_deployment(), height_m=heights_m)
    together_dbm = received_power_dbm(mixed, *POINTS)
    for height_m in np.unique(heights_m):
        alone_dbm = received_power_dbm(hexagonal_deployment(base_height_m=height_m), *POINTS)
        here = heights_m == height_m
        np.testing.assert_allclose(together_dbm[here], alone_dbm[here], rtol=0, atol=1e-9)
