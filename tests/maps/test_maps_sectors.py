"""What a map keeps of every sector, and what a world makes of it."""

import numpy as np
import pytest

from cellpilot.maps import make_map, simulate_map
from cellpilot.maps.sectors import sector_levels
from cellpilot.maps.sources import simulated
from cellpilot.radio import hexagonal_deployment, received_power_dbm
from cellpilot.signal import UNHEARD_DBM
from cellpilot.world import World

DEPLOYMENT = hexagonal_deployment(rings=0)
AREA = {"x_range_m": (-40.0, 40.0), "y_range_m": (-60.0, 60.0), "heights_m": (30.0, 60.0)}


def test_rsrp_of_a_bin_is_the_mean_of_its_points_in_db() -> None:
    radio_map = simulate_map(DEPLOYMENT, **AREA, points_per_side=2)
    here = {"x": -20.0, "y": 30.0, "z": 60.0}
    found = radio_map["rsrp_dbm"].sel(here, method="nearest")
    offset_m = np.array([-5.0, 5.0])
    x_m, y_m = float(found["x"]) + offset_m, float(found["y"]) + offset_m
    power_dbm = received_power_dbm(DEPLOYMENT, x_m, y_m[:, None], 60.0)
    np.testing.assert_allclose(found, power_dbm.mean(axis=(1, 2)) - 10 * np.log10(600), atol=1e-4)


def test_with_one_point_a_cell_the_best_sector_has_the_sinr_of_the_map() -> None:
    radio_map = simulate_map(DEPLOYMENT, **AREA, points_per_side=1)
    world = World.from_map(radio_map)
    assert world.signal.levels is not None
    serving = world.signal.levels.rsrp_dbm.argmax(axis=0)
    np.testing.assert_array_equal(serving, world.signal.serving_sector)
    np.testing.assert_allclose(
        world.signal.levels.sinr_db[serving, np.arange(world.grid.n_cells)], world.signal.mean_db, atol=1e-4
    )
    others = world.signal.levels.sinr_db.copy()
    others[serving, np.arange(world.grid.n_cells)] = -np.inf
    assert (others.max(axis=0) < world.signal.mean_db).all()


def test_beyond_the_limit_the_levels_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = simulate_map(DEPLOYMENT, **AREA, points_per_side=1)
    monkeypatch.setattr(simulated, "MAX_RSRP_VALUES", 3 * kept["sinr_db"].size - 1)
    radio_map = simulate_map(DEPLOYMENT, **AREA, points_per_side=1)
    assert "rsrp_dbm" not in radio_map
    assert World.from_map(radio_map).signal.levels is None
    assert radio_map.equals(kept.drop_vars("rsrp_dbm"))


def test_strips_do_not_change_the_map(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = simulate_map(DEPLOYMENT, **AREA, points_per_side=2)
    monkeypatch.setattr(simulated, "STRIP_LEVELS", 1)
    shares: list[float] = []
    assert simulate_map(DEPLOYMENT, **AREA, points_per_side=2, progress=shares.append).identical(whole)
    np.testing.assert_allclose(shares, np.arange(1, 7) / 6)


def test_an_unheard_sector_is_far_below_the_others() -> None:
    rsrp_dbm = np.array([[[[-80.0, -90.0]]], [[[np.nan, -85.0]]]])
    sectors = {f"sector_{name}": [value] * 2 for name, value in {"carrier_hz": 2e9, "bandwidth_hz": 10e6, "load": 1.0}.items()}
    axes = {"x_m": [0.0, 20.0], "y_m": [0.0], "z_m": [30.0]}
    radio_map = make_map(np.zeros((1, 1, 2)), **axes, source="test", optional={"rsrp_dbm": rsrp_dbm}, sectors=sectors)
    assert sector_levels(radio_map) is None  # nobody says how noisy the receiver is
    radio_map.attrs["noise_figure_db"] = 9.0
    found = sector_levels(radio_map)
    assert found is not None
    assert found[0][1].tolist() == [-np.inf, -85.0]
    levels = World.from_map(radio_map).signal.levels
    assert levels is not None
    assert levels.rsrp_dbm[1].tolist() == [UNHEARD_DBM, -85.0]
    noise_dbm = -95.0 - 10 * np.log10(600)
    assert found[1][0, 0] == pytest.approx(-80.0 - noise_dbm, abs=1e-6)
    assert found[1][0, 1] == pytest.approx(-90.0 - 10 * np.log10(10**-8.5 + 10 ** (noise_dbm / 10)), abs=1e-6)


@pytest.mark.parametrize("load", [0.0, 0.25, 0.6])
def test_sectors_that_are_not_always_busy_disturb_by_their_load(load: float) -> None:
    rsrp_dbm = np.array([[[[-80.0, -80.0]]], [[[-90.0, -85.0]]]])
    sectors = {"sector_carrier_hz": [2e9] * 2, "sector_bandwidth_hz": [10e6] * 2, "sector_load": [1.0, load]}
    axes = {"x_m": [0.0, 20.0], "y_m": [0.0], "z_m": [30.0]}
    radio_map = make_map(np.zeros((1, 1, 2)), **axes, source="test", optional={"rsrp_dbm": rsrp_dbm}, sectors=sectors)
    radio_map.attrs["noise_figure_db"] = 7.0
    found = sector_levels(radio_map)
    assert found is not None
    noise_mw = 10 ** ((-97.0 - 10 * np.log10(600)) / 10)
    for cell, other_dbm in enumerate((-90.0, -85.0)):
        assert found[1][0, cell] == pytest.approx(-80.0 - 10 * np.log10(load * 10 ** (other_dbm / 10) + noise_mw), abs=1e-6)
        assert found[1][1, cell] == pytest.approx(other_dbm - 10 * np.log10(10**-8.0 + noise_mw), abs=1e-6)
