"""The functions that compute what figures and tables show."""

import numpy as np
import pytest
import xarray as xr
from report_runs import small_map

from cellpilot.grid import Grid
from cellpilot.maps import make_map
from cellpilot.report.distributions import empirical_cdf, histogram_cdf, path_ratio_cdf, return_limits
from cellpilot.report.learning import ablation_curves, moving_mean, sensitivity_curves, smoothing_window, windows, without_gaps
from cellpilot.report.map_marks import site_places_m, special_cells
from cellpilot.report.maps import hexagons_m, low_probability_maps, sinr_map_figure
from cellpilot.report.numbers import percent, show
from cellpilot.report.plane import cell_edges_m, chosen_heights
from cellpilot.report.policies import chosen_goals, meaningful_cells
from cellpilot.world import World


def test_empirical_cdf_counts_values_up_to_and_including_each() -> None:
    values, share = empirical_cdf([3.0, 1.0, 2.0, 2.0])
    assert values.tolist() == [1, 2, 2, 3]
    assert share.tolist() == [0.25, 0.5, 0.75, 1]


def test_path_ratio_cdf_ends_at_the_share_that_reached() -> None:
    ratio, share = path_ratio_cdf([True, False, True, False], [4, 400, 3, 400], [2, 5, 3, 9])
    assert ratio.tolist() == [1.0, 2.0]
    assert share.tolist() == [0.25, 0.5]


def test_path_ratio_cdf_of_a_policy_that_never_arrives_is_empty() -> None:
    ratio, share = path_ratio_cdf([False, False], [9, 9], [1, 2])
    assert ratio.size == share.size == 0


def test_histogram_cdf_gives_the_share_below_each_level() -> None:
    levels, share = histogram_cdf([1, 2, 3, 4], [-1.0, 0.0, 1.0])
    assert levels.tolist() == [-1, 0, 1]
    assert share == pytest.approx([0.1, 0.3, 0.6])


def test_the_return_axis_is_not_ruled_by_a_policy_that_circles() -> None:
    good, bad = np.linspace(-5, 10, 200), np.full(200, -400.0)
    low, high = return_limits({"greedy": good, "optimal": good, "learned/argmax": bad})
    assert -25 < low < -5
    assert high > 10
    assert return_limits({"learned/argmax": bad})[0] < -400


def test_moving_mean_takes_whole_windows_and_places_them_at_their_centre() -> None:
    episode, mean = moving_mean([1.0, 2.0, 3.0, 6.0], 2)
    assert episode.tolist() == [1.5, 2.5, 3.5]
    assert mean.tolist() == [1.5, 2.5, 4.5]
    assert moving_mean([1.0, 3.0], 5)[1].tolist() == [2.0]


def test_a_round_in_which_no_flight_ended_shows_those_of_the_last_that_did() -> None:
    values, n_steps = [0.0, 4.0, 0.0, 0.0, 7.0], [0.0, 5.0, 0.0, 0.0, 3.0]
    np.testing.assert_array_equal(without_gaps(values, n_steps), [4.0, 4.0, 4.0, 4.0, 7.0])
    np.testing.assert_array_equal(without_gaps([1.0, 2.0], [3, 4]), [1.0, 2.0])
    np.testing.assert_array_equal(without_gaps([0.0, 0.0], [0, 0]), [0.0, 0.0])


def test_smoothing_window_never_exceeds_the_training() -> None:
    assert smoothing_window(30_000) == 300
    assert smoothing_window(100) == 10
    assert smoothing_window(1) == 1
    assert windows(np.zeros((3, 50_000)), 500)[1].shape[1] <= 801


def test_ablation_takes_the_spread_over_seeds_after_smoothing() -> None:
    returns = np.array([[[0.0, 2.0, 0.0, 2.0], [4.0, 6.0, 4.0, 6.0]]])
    data = xr.Dataset({"episode_return": (("variant", "seed", "episode"), returns)}, {"variant": ["DQN"], "seed": [0, 1]})
    _, mean, spread = ablation_curves(data, 2)["DQN"]
    assert mean == pytest.approx([3, 3, 3])
    assert spread == pytest.approx(np.full(3, np.std([1.0, 5.0], ddof=1)))


def test_sensitivity_points_are_ordered_and_kept_apart() -> None:
    data = xr.Dataset(
        {
            "knob": ("point", np.array(["rho_goal", "rho_goal", "rho_sinr/rho_step", "rho_goal"])),
            "policy": ("point", np.array(["a", "a", "a", "b"])),
            "value": ("point", [9.0, 1.0, 5.0, 7.0]),
        }
    )
    curves = sensitivity_curves(data, "rho_goal")
    assert {name: points["value"].values.tolist() for name, points in curves.items()} == {"a": [1, 9], "b": [7]}


def test_goals_lie_amid_low_and_amid_high_sinr() -> None:
    world = World.from_map(small_map(special=True))
    low, high = chosen_goals(world, 3.0)
    chance = world.signal.outage_probability(3.0)
    assert (chance[low], chance[high]) == (1.0, 0.0)
    assert (chance[world.airspace.next_cell[low]] == 1).all()
    assert (chance[world.airspace.next_cell[high]] == 0).all()
    assert chosen_goals(World.from_map(small_map(special=True)), 3.0) == (low, high)


def test_goals_are_in_the_largest_part() -> None:
    sinr_db = np.array([[[9.0, 9.0, np.nan, -9.0, 5.0, 6.0, 7.0]]])
    world = World.from_map(make_map(sinr_db, x_m=np.arange(7.0), y_m=[0.0], z_m=[30.0], source="test"))
    assert chosen_goals(world, 3.0) == (4, 5)  # both ends of a part lead only one way
    meaningful = meaningful_cells(world, 4)
    assert np.flatnonzero(meaningful).tolist() == [3, 5, 6]


def test_hexagons_touch_and_other_layouts_have_none() -> None:
    places_m = site_places_m(small_map())
    corners = hexagons_m(places_m)
    assert corners is not None
    assert corners.shape == (7, 6, 2)
    assert np.hypot(*(corners[0] - places_m[0]).T) == pytest.approx(500 / np.sqrt(3), abs=0.01)
    shared = np.abs(corners[0][:, None] - corners[1][None]).max(-1) < 0.01
    assert shared.sum() == 2
    assert hexagons_m(places_m * [1.0, 1.3]) is None
    assert hexagons_m(places_m[:1]) is None


def test_low_probability_is_one_map_without_noise_and_two_with_it() -> None:
    radio_map = small_map(2)
    assert list(low_probability_maps(World.from_map(radio_map), 3.0)) == ["without noise"]
    quiet, noisy = low_probability_maps(World.from_map(radio_map, 2.0), 3.0).values()
    assert quiet.shape == noisy.shape == (2, 6, 8)
    assert set(np.unique(quiet)) == {0.0, 1.0}
    assert ((noisy > 0) & (noisy < 1)).any()
    assert ((noisy > 0.5) == (quiet > 0.5)).all()


def test_edges_of_cells() -> None:
    assert cell_edges_m((10.0, 30.0), (0.0,)).tolist() == [0, 20, 40]
    assert cell_edges_m((10.0,), (0.0, 4.0)).tolist() == [8, 12]
    assert chosen_heights(5) == [0, 1, 2, 3, 4]
    assert chosen_heights(21) == [0, 4, 8, 12, 16, 20]


def test_special_cells_are_told_apart() -> None:
    cells = special_cells(small_map(special=True), 0)
    assert {name: int(area.sum()) for name, (area, _) in cells.items()} == {
        "blocked: inside a building": 3,
        "blocked: no ray arrives": 1,
        "unknown, counts as below": 0,
    }
    assert len({look for _, look in cells.values()}) == 3


def test_percent_never_rounds_a_failure_away() -> None:
    assert percent(1.0) == "100.00 %"
    assert percent(0.99999) == "99.999 %"
    assert percent(0.000001) == "0.0001 %"
    assert percent(0.034) == "3.40 %"
    assert show(float("inf"), "number") == "∞"
    assert show(-0.0001, "number") == "0.00"
    assert show(-2.5701, "score") == "−2.570"
    assert show(None, "percent") == "–"


@pytest.mark.parametrize("threshold_db", [-100.0, 3.0, 100.0])
def test_a_map_is_drawn_whatever_the_threshold(threshold_db: float) -> None:
    figure = sinr_map_figure(small_map(2, special=True), threshold_db)
    assert len([axes for axes in figure.axes if axes.get_title()]) == 2


def test_a_map_of_one_row_is_drawn() -> None:
    radio_map = make_map([[[1.0, 5.0, 9.0]]], x_m=[0.0, 10.0, 20.0], y_m=[0.0], z_m=[30.0], source="test")
    assert Grid((0.0, 10.0, 20.0), (0.0,), (30.0,)).n_cells == radio_map["sinr_db"].size
    assert sinr_map_figure(radio_map, 3.0).axes
