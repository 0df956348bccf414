"""Gridding as properties, against a plain dictionary of lists."""

import statistics
from collections import defaultdict
from math import floor

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.maps import Bins, grid_samples

SAMPLE = st.tuples(
    st.floats(-300, 300), st.floats(-300, 300), st.sampled_from([20.0, 30.0, 50.0]), st.floats(-20, 30, allow_subnormal=False)
)
SAMPLES = st.lists(SAMPLE, min_size=1, max_size=60)
BIN_M = st.sampled_from([7.0, 20.0, 40.0, 100.0])


def grid(samples: list[tuple[float, float, float, float]], bin_m: float) -> Bins:
    return grid_samples(*np.array(samples).T, bin_m)


def assert_same(one: Bins, other: Bins) -> None:
    for name in ("x_m", "y_m", "z_m", "mean", "std", "count"):
        assert getattr(one, name).tobytes() == getattr(other, name).tobytes(), name


@settings(deadline=None)
@given(SAMPLES, BIN_M, st.randoms(use_true_random=False))
def test_order_changes_nothing(samples: list[tuple[float, float, float, float]], bin_m: float, random: st.DataObject) -> None:
    shuffled = samples.copy()
    random.shuffle(shuffled)  # type: ignore[attr-defined]
    assert_same(grid(samples, bin_m), grid(shuffled, bin_m))


@settings(deadline=None)
@given(SAMPLES, BIN_M)
def test_against_a_dictionary(samples: list[tuple[float, float, float, float]], bin_m: float) -> None:
    cells = defaultdict(list)
    for x_m, y_m, z_m, value in samples:
        cells[floor(x_m / bin_m), floor(y_m / bin_m), z_m].append(value)
    bins = grid(samples, bin_m)
    assert bins.count.sum() == len(samples)
    assert (bins.count > 0).sum() == len(cells)
    assert np.array_equal(np.isnan(bins.mean), bins.count == 0)
    assert np.array_equal(np.isnan(bins.std), bins.count < 2)
    for (ix, iy, z_m), values in cells.items():
        place = (
            int(np.abs(bins.z_m - z_m).argmin()),
            int(np.abs(bins.y_m - (iy + 0.5) * bin_m).argmin()),
            int(np.abs(bins.x_m - (ix + 0.5) * bin_m).argmin()),
        )
        assert bins.count[place] == len(values)
        assert bins.mean[place] == pytest.approx(statistics.fmean(values), abs=1e-9)
        if len(values) > 1:
            assert bins.std[place] == pytest.approx(statistics.stdev(values), abs=1e-6)


@settings(deadline=None)
@given(SAMPLES, BIN_M, st.integers(-5, 5))
def test_bin_edges_belong_to_the_anchor(samples: list[tuple[float, float, float, float]], bin_m: float, shift: int) -> None:
    """Adding a far sample stretches the grid and moves no bin."""
    bins = grid(samples, bin_m)
    more = grid([*samples, (400.0 + shift, -400.0, 30.0, 0.0)], bin_m)
    counts = {
        (x, y, z): bins.count[iz, iy, ix]
        for iz, z in enumerate(bins.z_m)
        for iy, y in enumerate(bins.y_m)
        for ix, x in enumerate(bins.x_m)
        if bins.count[iz, iy, ix]
    }
    for (x, y, z), count in counts.items():
        index = (*(np.flatnonzero(axis == value)[0] for axis, value in ((more.z_m, z), (more.y_m, y), (more.x_m, x))),)
        assert more.count[index] - count in (0, 1)
    assert more.count.sum() == bins.count.sum() + 1


def test_a_crowded_bin_sums_to_the_same_last_bit_in_any_order() -> None:
    rng = np.random.default_rng(4)
    samples = np.column_stack([rng.uniform(0, 80, (1000, 2)), np.full(1000, 30.0), rng.normal(0, 8, 1000)])
    bins = grid_samples(*samples.T, 40.0)
    for _ in range(5):
        assert_same(bins, grid_samples(*rng.permutation(samples).T, 40.0))


def test_edges_are_closed_below_and_holes_stay_unknown() -> None:
    bins = grid_samples([0.0, 39.999, 40.0, 120.0], [0.0, 0.0, 0.0, 0.0], [30.0] * 4, [1.0, 3.0, 5.0, 7.0], 40.0)
    assert bins.x_m.tolist() == [20.0, 60.0, 100.0, 140.0]
    assert bins.count.ravel().tolist() == [2, 1, 0, 1]
    assert np.array_equal(bins.mean.ravel(), [2.0, 5.0, np.nan, 7.0], equal_nan=True)


def test_samples_left_out_stretch_the_grid_only() -> None:
    bins = grid_samples([5.0, 45.0], [5.0, 5.0], [30.0, 50.0], [1.0, 9.0], 40.0, keep=[True, False])
    assert bins.count.shape == (2, 1, 2)
    assert bins.count.sum() == 1


@pytest.mark.parametrize(
    ("x_m", "value", "bin_m", "message"),
    [
        ([0.0, 1.0], [1.0, 2.0], 0.0, "bin size is 0 m"),
        ([0.0, 1.0], [1.0, 2.0], np.nan, "bin size is nan m"),
        ([], [], 40.0, "0 value"),
        ([0.0], [1.0, 2.0], 40.0, "2 value"),
        ([0.0, np.nan], [1.0, 2.0], 40.0, "not finite"),
        ([0.0, 1.0], [1.0, np.inf], 40.0, "not finite"),
        ([0.0, 1e12], [1.0, 2.0], 40.0, "stray positions"),
    ],
)
def test_wrong_samples_are_refused(x_m: list[float], value: list[float], bin_m: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        grid_samples(x_m, x_m, x_m, value, bin_m)


def test_an_area_of_too_many_bins_is_refused() -> None:
    with pytest.raises(InputError, match=r"1000 km x 1000 km, too many bins of 40 m"):
        grid_samples([0.0, 1e6], [0.0, 1e6], [30.0, 30.0], [1.0, 2.0], 40.0)
