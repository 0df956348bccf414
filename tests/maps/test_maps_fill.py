"""Filling from neighbours, against a brute-force version over all pairs of cells."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellpilot.errors import InputError
from cellpilot.maps import RadioMap, fill, grid_samples, make_map
from cellpilot.maps.estimate.fill import measured_cells
from cellpilot.maps.estimate.methods import Known, gaussian_process
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_SINR, blocked_cells, reasons_text


def build(sinr_db: np.ndarray, bin_m: float = 20.0) -> RadioMap:
    nz, ny, nx = sinr_db.shape
    axes = {"x_m": bin_m * (np.arange(nx) + 0.5), "y_m": bin_m * (np.arange(ny) - 2.5), "z_m": 30.0 + 10 * np.arange(nz)}
    return make_map(sinr_db, **axes, source="test", count=np.where(np.isnan(sinr_db), 0, 3))


@settings(deadline=None)
@given(
    arrays(np.float32, (2, 4, 5), elements=st.floats(-20, 30, width=32) | st.just(float("nan"))),
    st.sampled_from([0.0, 20.0, 40.0, 45.0, 80.0]),
    st.sampled_from([1.0, 2.0]),
)
def test_against_all_pairs(sinr_db: np.ndarray, radius_m: float, power: float) -> None:
    sinr_db[:, 0, 0] = [1.0, 2.0]
    result = fill(build(sinr_db), radius_m, power=power)
    errors_db = []
    for iz, iy, ix in np.ndindex(sinr_db.shape):
        near = [
            (np.hypot(jy - iy, jx - ix) * 20, float(sinr_db[iz, jy, jx]))
            for jy, jx in np.ndindex(4, 5)
            if (jy, jx) != (iy, ix) and not np.isnan(sinr_db[iz, jy, jx]) and np.hypot(jy - iy, jx - ix) * 20 <= radius_m + 1e-6
        ]
        mean_db = np.average([v for _, v in near], weights=[d**-power for d, _ in near]) if near else np.nan
        cell = result.isel(z=iz, y=iy, x=ix)
        if np.isnan(sinr_db[iz, iy, ix]):
            np.testing.assert_allclose(cell["sinr_db"].item(), mean_db, atol=1e-4)
            assert cell["filled"].item() == (not np.isnan(mean_db))
            assert blocked_cells(cell).item() == np.isnan(mean_db)
        else:
            assert cell["sinr_db"].item() == sinr_db[iz, iy, ix]
            assert not cell["filled"].item()
            errors_db.append(mean_db - sinr_db[iz, iy, ix])
    known = ~np.isnan(errors_db)
    if result["filled"].values.any() and known.any():
        expected = np.sqrt(np.mean(np.square(errors_db)[known]))
        np.testing.assert_allclose(result["sinr_std_db"].values[result["filled"].values], expected, rtol=1e-4, atol=1e-4)


def line(*values: float) -> RadioMap:
    return build(np.array(values, dtype=np.float32)[None, None])


def test_filling_is_recorded_and_counts_no_samples() -> None:
    before = line(1.0, np.nan, 3.0, np.nan, np.nan, np.nan, np.nan)
    result = fill(before, 20.0)
    assert result["filled"].values.ravel().tolist() == [False, True, False, True, False, False, False]
    assert result["sinr_db"].values.ravel()[[1, 3]].tolist() == [2.0, 3.0]
    assert blocked_cells(result).ravel().tolist() == [False] * 4 + [True] * 3
    assert result["count"].values.ravel().tolist() == [3, 0, 3, 0, 0, 0, 0]
    assert (result.attrs["fill_radius_m"], result.attrs["fill_power"]) == (20.0, 2.0)
    assert "inverse distance" in result.attrs["fill_method"]
    assert np.isnan(before["sinr_db"].values).sum() == 5
    assert not before["filled"].values.any()


def test_what_was_filled_is_no_source_of_the_next_filling() -> None:
    once = fill(line(1.0, np.nan, np.nan, 8.0), 20.0)
    assert fill(once, 20.0)["sinr_db"].identical(once["sinr_db"])
    assert fill(line(1.0, np.nan, np.nan, np.nan), 20.0)["sinr_db"].values.ravel()[2:].tolist() != [1.0, 1.0]


def test_only_cells_that_lack_data_become_free() -> None:
    before = line(1.0, np.nan, np.nan, 3.0)
    before["blocked_reason"].values[0, 0, 2] = 2
    before.attrs["blocked_reasons"] = reasons_text((NO_SINR, INSIDE_BUILDING))
    for unknown in ("blocked", "bad"):
        result = fill(before, 20.0, unknown=unknown)
        assert result["filled"].values.ravel().tolist() == [False, True, True, False]
        assert result["blocked_reason"].values.ravel().tolist() == [0, 0, 2, 0]


def test_unknown_bad_leaves_the_rest_free() -> None:
    result = fill(line(1.0, np.nan, np.nan, np.nan), 20.0, unknown="bad")
    assert not blocked_cells(result).any()
    assert np.isnan(result["sinr_db"].values).sum() == 2
    assert result.attrs["unknown"] == "bad"


def test_without_pairs_the_uncertainty_is_the_spread_of_the_measured_cells() -> None:
    result = fill(line(1.0, np.nan, np.nan, 5.0), 20.0)
    assert result["sinr_std_db"].values.ravel()[1] == pytest.approx(np.std([1, 5], ddof=1))


@pytest.mark.parametrize(
    ("settings_", "message"),
    [
        ({"radius_m": -1.0}, "fill radius is -1"),
        ({"radius_m": np.nan}, "fill radius"),
        ({"power": 0.0}, "power"),
        ({"unknown": "x"}, "'x'"),
    ],
)
def test_wrong_settings_are_refused(settings_: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        fill(line(1.0, np.nan), **({"radius_m": 20.0} | settings_))  # type: ignore[arg-type]


def test_what_the_estimates_get_of_a_cell_are_the_squares_of_its_samples() -> None:
    values_db = np.array([3.0, 5.0, 10.0, 7.0])
    bins = grid_samples([1.0, 2.0, 3.0, 25.0], np.ones(4), np.full(4, 30.0), values_db, 10.0)
    radio_map = make_map(
        bins.mean,
        x_m=bins.x_m,
        y_m=bins.y_m,
        z_m=bins.z_m,
        source="test",
        count=bins.count,
        optional={"sinr_spread_db": bins.std},
    )
    known = measured_cells(radio_map)
    assert known.n_samples.tolist() == [3.0, 1.0]
    np.testing.assert_allclose(known.squares_db2, [((values_db[:3] - 6.0) ** 2).sum(), 0.0], rtol=1e-6)


def test_a_cell_of_many_samples_is_surer_than_one_of_a_single_sample() -> None:
    points_m = np.array([(20.0 * i, 0.0, 30.0) for i in range(12)])
    n_samples = np.where(np.arange(12) % 2, 400.0, 1.0)
    values_db = np.random.default_rng(0).normal(0.0, 6.0, 12)
    known = Known(points_m, values_db, n_samples, 5.0**2 * (n_samples - 1), np.zeros(12))
    std_db = gaussian_process(known, points_m, np.zeros(12)).std_db
    assert std_db[1::2].max() < 0.5 * std_db[::2].min()
