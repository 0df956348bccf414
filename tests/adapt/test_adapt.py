"""From map A to the unknown network B: common grids, what each arm may know, and the words about it."""

from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps import Anchor, RadioMap, make_map
from cellpilot.scenario import MeasuredMap, SimulatedMap
from cellpilot.studies.adapt import adaptation, checkpoints_up_to, likeness
from cellpilot.studies.adapt_arms import FROZEN, NOTHING, ONLINE, PRIOR
from cellpilot.studies.adapt_maps import common_grid, make_transfer, make_transfer_maps, read_place
from cellpilot.studies.adapt_words import in_words, summary, verdict
from cellpilot.task import Task

TASK = Task(max_steps=140)
MAP_ARMS = (PRIOR, NOTHING)
SYNTHETIC = {height_m: Path(str(files("cellpilot") / "data" / f"synthetic_{height_m}m.csv")) for height_m in (30, 50)}


def lattice_map(ix: range, iy: range, z_m: tuple[float, ...] = (30.0,), bin_m: float = 20.0, **more: object) -> RadioMap:
    """A map whose SINR tells the place: 100 ix + iy (+ 0.5 for each height), plus `offset`."""
    z, y, x = np.meshgrid(np.arange(len(z_m)), np.array(iy), np.array(ix), indexing="ij")
    axes = {"x_m": bin_m * np.array(ix), "y_m": bin_m * np.array(iy), "z_m": z_m}
    return make_map(100.0 * x + y + 0.5 * z, source="test", **axes, **more)  # type: ignore[arg-type]


def hills(level_db: float = 0.0, phase: float = 0.0) -> RadioMap:
    """8 x 8 cells with bad valleys."""
    y, x = np.meshgrid(np.arange(8), np.arange(8), indexing="ij")
    sinr_db = level_db + 3 + 8 * np.cos(x - phase) + 3 * np.sin(1.3 * y)
    return make_map(sinr_db[None], x_m=20.0 * np.arange(8), y_m=20.0 * np.arange(8), z_m=[30.0], source="test")


def test_only_the_shared_rectangle_stays_and_places_keep_their_values() -> None:
    a, b = common_grid(lattice_map(range(6), range(2, 9)), lattice_map(range(3, 10), range(5), z_m=(50.0,)))
    for found in (a, b):
        np.testing.assert_array_equal(found["x"].values, 20.0 * np.arange(3, 6))
        np.testing.assert_array_equal(found["y"].values, 20.0 * np.arange(2, 5))
        assert found["z"].values.tolist() == [50.0]
        for ix in range(3, 6):
            for iy in range(2, 5):
                assert float(found["sinr_db"].sel(x=20 * ix, y=20 * iy, z=50)) == 100 * ix + iy


@pytest.mark.parametrize(
    ("other", "named"),
    [
        ({"ix": range(4), "iy": range(4), "bin_m": 40.0}, ["20 m in A", "40 m in B"]),
        ({"ix": range(7, 9), "iy": range(4)}, ["along x", "none is shared"]),
        ({"ix": range(4), "iy": range(4), "z_m": (30.0, 50.0)}, ["heights 30 m in A", "30, 50 m in B"]),
        ({"ix": range(4), "iy": range(4), "anchor": Anchor(1.0, 2.0)}, ["0.000000, 0.000000", "1.000000, 2.000000", "anchor"]),
    ],
)
def test_grids_that_cannot_be_brought_together_are_refused(other: dict, named: list[str]) -> None:
    with pytest.raises(InputError) as error:
        common_grid(lattice_map(range(4), range(4), anchor=Anchor(0.0, 0.0)), lattice_map(**other))
    assert all(part in str(error.value) for part in named)


def test_bins_shifted_by_half_a_bin_share_nothing() -> None:
    a = lattice_map(range(4), range(4))
    with pytest.raises(InputError, match="none is shared"):
        common_grid(a, a.assign_coords(x=a["x"] + 10.0))


def test_logs_of_two_heights_lie_on_one_grid_and_are_filled() -> None:
    settings = [MeasuredMap(logs=(SYNTHETIC[h],), bin_m=60.0, fill_radius_m=1e5) for h in (50, 30)]
    a, b = make_transfer_maps(*settings)
    for axis in "xyz":
        np.testing.assert_array_equal(a[axis].values, b[axis].values)
    assert b["z"].values.tolist() == [30.0]
    assert not np.isnan(a["sinr_db"].values).any()
    assert not np.isnan(b["sinr_db"].values).any()
    # The field of the synthetic logs is the same at both heights but for its level and one slow wave.
    assert np.corrcoef(a["sinr_db"].values.ravel(), b["sinr_db"].values.ravel())[0, 1] > 0.7


def test_a_simulation_takes_the_grid_of_a_measured_map_and_its_level_from_another_height() -> None:
    simulated = SimulatedMap(points_per_side=1)
    logs = {h: MeasuredMap(logs=(SYNTHETIC[h],), bin_m=60.0, fill_radius_m=1e5) for h in (30, 50)}
    plain, b = make_transfer_maps(simulated, logs[30])
    calibrated, _ = make_transfer_maps(simulated, logs[30], logs[50])
    for axis in "xyz":
        np.testing.assert_allclose(plain[axis].values, b[axis].values)
    shift_db = calibrated["sinr_db"].values - plain["sinr_db"].values
    np.testing.assert_allclose(shift_db, shift_db.mean(), atol=1e-4)
    known, _ = make_transfer_maps(logs[50], logs[30])
    assert float(calibrated["sinr_db"].mean()) == pytest.approx(float(known["sinr_db"].mean()), abs=1e-3)


def test_a_place_is_a_map_a_log_or_a_scenario(tmp_path: Path) -> None:
    for name in ("some.nc", "some.zarr", "some.tif"):
        assert read_place(name, 40.0)[0].kind == "file"
    log, scenario = read_place("some.csv", 25.0)
    assert isinstance(log, MeasuredMap)
    assert (log.bin_m, scenario) == (25.0, None)
    settings, scenario = read_place("thesis-2d-noise", 40.0)
    assert scenario is not None
    assert (settings.kind, scenario.task.noise_std_db) == ("simulated", 2.0)
    with pytest.raises(InputError, match="no such scenario"):
        read_place("nowhere", 40.0)


def test_the_truth_is_certain_and_holes_of_a_are_no_holes() -> None:
    a, b = hills(level_db=5.0), hills()
    a["sinr_db"].values[0, 2, 3] = np.nan
    b["sinr_std_db"].values[:] = 1.5
    b["blocked_reason"].values[0, 7, 7] = 1
    transfer = make_transfer(a, b, TASK, 2.0)
    assert not transfer.truth.signal.std_db.any()
    assert transfer.truth.signal.noise_std_db == transfer.prepared.signal.noise_std_db == 2.0
    np.testing.assert_array_equal(transfer.truth.signal.mean_db, b["sinr_db"].values.ravel())
    np.testing.assert_array_equal(transfer.prepared.airspace.blocked, transfer.truth.airspace.blocked)
    hole = 2 * 8 + 3
    assert transfer.prepared.signal.mean_db[hole] == pytest.approx(np.nanmean(a["sinr_db"].values), abs=1e-4)
    others = np.arange(64) != hole
    np.testing.assert_array_equal(transfer.prepared.signal.mean_db[others], a["sinr_db"].values.ravel()[others])


def test_a_too_large_map_is_refused() -> None:
    axes = {"x_m": 20.0 * np.arange(60), "y_m": 20.0 * np.arange(60), "z_m": [30.0]}
    large = make_map(np.zeros((1, 60, 60)), source="test", **axes)
    with pytest.raises(InputError, match="3,600 cells"):
        make_transfer(large, large, TASK, 0.0)


def test_curves_repeat_and_only_the_arm_with_a_prior_knows_a() -> None:
    b = hills()
    transfer = make_transfer(hills(level_db=-4.0), b, TASK, 1.0)
    data = adaptation(transfer, 3, 2, MAP_ARMS)
    assert data["flights"].values.tolist() == [0, 1, 2, 3]
    assert data["score"].dims == ("arm", "seed", "flights")
    assert (data["reached_share"].values == 1.0).all()
    xr.testing.assert_identical(adaptation(transfer, 3, 2, MAP_ARMS), data)
    other = adaptation(make_transfer(hills(phase=1.5), b, TASK, 1.0), 3, 2, MAP_ARMS)
    np.testing.assert_array_equal(other["score"].sel(arm=NOTHING), data["score"].sel(arm=NOTHING))
    assert (other["score"].sel(arm=PRIOR) != data["score"].sel(arm=PRIOR)).any()
    seeds = data["score"].sel(arm=NOTHING, flights=3).values
    assert seeds[0] != seeds[1]


def test_a_right_prior_is_near_the_optimum_before_the_first_flight() -> None:
    data = adaptation(make_transfer(hills(), hills(), TASK, 0.0), 1, 1, MAP_ARMS)
    before = {arm: float(data["score"].sel(arm=arm, flights=0, seed=0)) for arm in MAP_ARMS}
    assert data.attrs["score_of_optimum_of_a"] == 1.0
    assert before[PRIOR] > 0.8
    assert before[PRIOR] > before[NOTHING] + 0.3


def test_how_like_two_maps_are() -> None:
    a, b = hills(level_db=-4.0), hills()
    b["blocked_reason"].values[0, 7, 7] = 1
    b["sinr_db"].values[0, 7, 7] = 1_000.0  # no cell to fly in: it does not count
    like = likeness(make_transfer(a, b, TASK, 0.0))
    assert like["correlation"] == pytest.approx(1.0, abs=1e-6)
    assert like["level_difference_db"] == pytest.approx(-4.0, abs=1e-5)
    low_a, low_b = (m["sinr_db"].values.ravel()[:63] < TASK.threshold_db for m in (a, b))
    assert (like["low_share_a"], like["low_share_b"]) == pytest.approx((low_a.mean(), low_b.mean()))
    assert like["threshold_agreement"] == pytest.approx((low_a == low_b).mean())
    assert "correlation 1.00" in in_words(xr.Dataset(attrs=like | {"score_of_optimum_of_a": 0.5}))
    flat = likeness(make_transfer(a * 0, b, TASK, 0.0))
    assert np.isnan(flat["correlation"])


def test_the_table_has_the_lead_of_the_prior_seed_by_seed() -> None:
    scores = np.zeros((2, 3, 2))
    scores[0, :, 0] = [0.5, 0.7, 0.9]
    scores[1, :, 0] = [0.4, 0.6, 0.8]  # the seeds differ, the lead does not
    reached = np.ones_like(scores)
    reached[1, :, 1] = [1.0, 0.9, 0.8]
    dims = ("arm", "seed", "flights")
    curves = {"score": (dims, scores), "reached_share": (dims, reached)}
    data = xr.Dataset(curves, {"arm": [PRIOR, NOTHING], "flights": [0, 2]})
    heads, first, last = summary(data)
    assert heads == ["flights", PRIOR, NOTHING, f"{NOTHING}: reached", "lead of the prior"]
    assert first == ["0", "0.700 ± 0.497", "0.600 ± 0.497", "100.0 %", "+0.100 ± 0.000"]
    assert last == ["2", "0.000 ± 0.000", "0.000 ± 0.000", "90.0 %", "+0.000 ± 0.000"]
    assert len(summary(data.sel(arm=[PRIOR]))[0]) == 2


def test_a_threshold_without_anything_to_gain_is_refused() -> None:
    with pytest.raises(InputError, match="no better than the shortest path"):
        adaptation(make_transfer(hills(), hills(), replace(TASK, threshold_db=-90.0), 0.0), 1, 1)


@pytest.mark.parametrize(("flights", "expected"), [(1, [0, 1]), (4, [0, 1, 2, 3, 4]), (10, [0, 1, 2, 3, 5, 7, 10])])
def test_checkpoints_end_with_the_last_flight(flights: int, expected: list[int]) -> None:
    assert checkpoints_up_to(flights) == expected


def test_words_about_a_prior_that_helps_first_and_harms_later() -> None:
    rng = np.random.default_rng(0)
    means = {PRIOR: [0.7, 0.8, 0.9, 0.91], NOTHING: [0.0, 0.5, 0.9, 0.99]}
    scores = np.stack([np.array(m) + 0.02 * rng.standard_normal((20, 4)) for m in means.values()])
    scores[:, :, 2] = 0.905  # equal
    data = xr.Dataset({"score": (("arm", "seed", "flights"), scores)}, {"arm": list(means), "flights": [0, 1, 5, 20]})
    helps, harms, needed = verdict(data)
    assert "helps" in helps
    assert helps.endswith("after 0, 1 flights")
    assert "harms" in harms
    assert harms.endswith("after 20 flights")
    assert needed == "mean score 0.9: after 5 with the prior, after 5 without"
    assert verdict(data.sel(arm=[PRIOR])) == []


def test_one_seed_claims_no_difference() -> None:
    scores = np.array([[[0.7, 0.8]], [[0.0, 0.5]]])
    data = xr.Dataset({"score": (("arm", "seed", "flights"), scores)}, {"arm": [PRIOR, NOTHING], "flights": [0, 1]})
    (line,) = verdict(data)
    assert "at least two seeds" in line
    assert "`seeds` 2" in line


@pytest.mark.slow
def test_the_deep_arms_know_a_and_only_one_of_them_learns() -> None:
    settings = FQIHER(rounds=40, flights=16, batch_size=256, hidden_units=32)
    data = adaptation(make_transfer(hills(), hills(phase=1.5), TASK, 0.0, settings), 15, 1, (FROZEN, ONLINE))
    frozen, online = (data["score"].sel(arm=arm, seed=0).values for arm in (FROZEN, ONLINE))
    assert (frozen == frozen[0]).all()
    assert online[0] != online[-1]
    assert online[-1] > frozen[0] + 0.1
