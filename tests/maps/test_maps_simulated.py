"""Simulated maps: the mean of a fine lattice of the radio model."""

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, anchor_of, simulate_map
from cellpilot.maps.reasons import blocked_cells
from cellpilot.maps.sources.simulated import _most_frequent
from cellpilot.radio import hexagonal_deployment, simulate

DEPLOYMENT = hexagonal_deployment()
SMALL = {"x_range_m": (-40.0, 80.0), "y_range_m": (0.0, 40.0), "points_per_side": 4}


@pytest.mark.parametrize("shadowing_seed", [None, 3])
def test_bins_are_means_of_their_points(shadowing_seed: int | None) -> None:
    dataset = simulate_map(DEPLOYMENT, **SMALL, heights_m=(30.0, 60.0), shadowing_seed=shadowing_seed)  # type: ignore[arg-type]
    assert dataset["sinr_db"].shape == (2, 2, 6)
    for z_m, y_m, x_m in ((30, 10, -30), (60, 30, 70)):
        x = [x_m + offset for offset in (-7.5, -2.5, 2.5, 7.5)] * 4
        y = np.repeat([y_m + offset for offset in (-7.5, -2.5, 2.5, 7.5)], 4)
        points = simulate(DEPLOYMENT, x, y, np.full(16, z_m), shadowing_seed=shadowing_seed)
        cell = dataset.sel(z=z_m, y=y_m, x=x_m)
        assert cell["sinr_db"].item() == pytest.approx(points.sinr_db.mean(), abs=1e-4)
        assert cell["sinr_spread_db"].item() == pytest.approx(points.sinr_db.std(ddof=1), abs=1e-4)
        assert cell["serving_sector"].item() == np.bincount(points.serving_sector).argmax()
        assert cell["count"].item() == 16


def test_nothing_about_a_simulation_is_unknown() -> None:
    dataset = simulate_map(DEPLOYMENT, **SMALL)  # type: ignore[arg-type]
    assert not dataset["sinr_std_db"].values.any()
    assert not blocked_cells(dataset).any()
    assert "seed" not in dataset.attrs


def test_sites_and_settings_are_kept() -> None:
    anchor = Anchor(47.0, 8.0)
    dataset = simulate_map(DEPLOYMENT, **SMALL, shadowing_seed=5, anchor=anchor)  # type: ignore[arg-type]
    assert dataset["sector_x_m"].values.tolist() == DEPLOYMENT.x_m.tolist()
    assert dataset["sector_boresight_deg"].values.tolist() == DEPLOYMENT.boresight_deg.tolist()
    assert dataset["sector_name"].values[4] == "site 1, 150 deg"
    assert dataset.attrs["seed"] == 5
    assert anchor_of(dataset) == anchor


def test_seeds_differ_and_repeat() -> None:
    maps = [simulate_map(DEPLOYMENT, **SMALL, shadowing_seed=seed)["sinr_db"].values for seed in (1, 2, 1)]  # type: ignore[arg-type]
    assert np.array_equal(maps[0], maps[2])
    assert not np.isclose(maps[0], maps[1], atol=0.01).any()


def test_one_point_for_each_bin_has_no_spread() -> None:
    dataset = simulate_map(DEPLOYMENT, points_per_side=1)
    assert np.isnan(dataset["sinr_spread_db"].values).all()
    assert dataset.sizes == {"z": 1, "y": 20, "x": 20, "sector": 21}


def test_ties_go_to_the_lowest_sector() -> None:
    assert _most_frequent(np.array([[2, 1, 2, 1], [0, 3, 3, 0], [3, 3, 3, 0]])).tolist() == [1, 0, 3]


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"x_range_m": (0.0, 50.0)}, "x spans 50 m, which is 2.5 bins of 20 m"),
        ({"y_range_m": (40.0, 0.0)}, "y runs from 40 to 0 m"),
        ({"bin_m": 0.0}, "bins of 0 m"),
        ({"heights_m": (50.0, 30.0)}, "heights are 50, 30 m"),
        ({"heights_m": ()}, "heights are none"),
        ({"heights_m": (900.0,)}, "900"),
        ({"points_per_side": 0}, "points_per_side is 0"),
        ({"environment": "Moon"}, "Moon"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        simulate_map(DEPLOYMENT, **settings)  # type: ignore[arg-type]
