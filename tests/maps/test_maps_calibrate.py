"""A simulation brought to the level and spread of measurements, by hand numbers."""

from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, fill, load_map, make_map, save_map, to_degrees, validate
from cellpilot.maps.calibrate import calibrate
from cellpilot.world import World

NAN = np.nan
HERE = Anchor(47.0, 8.0)


def build(sinr_db: object, x0_m: float = 0.0, z_m: tuple[float, ...] = (30.0,), anchor: Anchor | None = None) -> RadioMap:
    values = np.array(sinr_db, dtype=float)
    _, ny, nx = values.shape
    return make_map(values, x_m=x0_m + 20.0 * np.arange(nx), y_m=20.0 * np.arange(ny), z_m=z_m, source="test", anchor=anchor)


def slope(x0_m: float, nx: int, z_m: tuple[float, ...] = (30.0, 50.0), anchor: Anchor | None = None) -> RadioMap:
    """SINR that rises by 0.1 dB a metre east, falls by 0.05 north, and rises by 0.2 a metre up."""
    z, y, x = np.meshgrid(z_m, 20.0 * np.arange(3), x0_m + 20.0 * np.arange(nx), indexing="ij")
    return build(0.1 * x - 0.05 * y + 0.2 * z, x0_m, z_m, anchor)


def test_by_hand() -> None:
    """Simulated 0 2 4 6 (mean 3, variance 5), measured 10 10 14 14 (mean 12, variance 4)."""
    result = calibrate(build([[[0.0, 2.0, 4.0, 6.0]]]), build([[[10.0, 10.0, 14.0, 14.0]]]))
    factor = np.sqrt(4 / 5)
    assert (result.cells, result.offset_db, result.spread_factor) == (4, 9.0, pytest.approx(factor))
    adjusted_db = 12 + factor * np.array([-3.0, -1.0, 1.0, 3.0])
    np.testing.assert_allclose(result.radio_map["sinr_db"].values.ravel(), adjusted_db, atol=1e-5)
    before, after = result.before, result.after
    correlation = (6 + 2 + 2 + 6) / np.sqrt(20 * 16)
    rmse_db = np.sqrt(np.mean([100, 64, 100, 64]))
    assert before == pytest.approx((-9.0, np.sqrt(5 / 4), rmse_db, correlation))
    left_db = np.sqrt(np.mean((adjusted_db - [10, 10, 14, 14]) ** 2))
    assert after == pytest.approx((0.0, 1.0, left_db, correlation))
    np.testing.assert_allclose(result.radio_map["sinr_std_db"].values, left_db, rtol=1e-6)


def test_the_offset_is_as_uncertain_as_the_mean_of_correlated_errors() -> None:
    """Four cells 20 m apart: pairs at 20, 40 and 60 m count by exp(-distance / 50 m), or as the simulation states it."""
    simulated, measured = build([[[0.0, 2.0, 4.0, 6.0]]]), build([[[10.0, 10.0, 14.0, 14.0]]])
    for length_m in (50.0, 20.0):
        result = calibrate(simulated, measured)
        pairs = np.exp(-np.array([20, 40, 60]) / length_m) @ [6, 4, 2]
        assert result.offset_std_db == pytest.approx(result.after.rmse_db * np.sqrt((4 + pairs) / 16))
        simulated.attrs["sinr_correlation_m"] = 20.0


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".csv", ".tif"])
def test_files_keep_the_common_error_and_the_world_draws_it(tmp_path: Path, suffix: str) -> None:
    pytest.importorskip({".zarr": "zarr", ".tif": "rasterio"}.get(suffix, "numpy"))
    simulated = build([[[0.0, 2.0, 4.0, 6.0]]], anchor=HERE)
    result = calibrate(simulated, build([[[10.0, 10.0, 14.0, 14.0]]], anchor=HERE))
    save_map(result.radio_map, tmp_path / f"map{suffix}")
    read = load_map(tmp_path / f"map{suffix}")
    assert read.attrs["sinr_common_std_db"] == result.offset_std_db
    drawn = [World.from_map(m).signal.unknown.draw(np.eye(4, dtype=np.float32)) for m in (read, result.radio_map)]  # type: ignore[union-attr]
    np.testing.assert_array_equal(*drawn)
    covariance = drawn[0].T @ drawn[0]
    np.testing.assert_allclose(np.diagonal(covariance), result.after.rmse_db**2, rtol=1e-5)
    kept = result.offset_std_db**2 + (result.after.rmse_db**2 - result.offset_std_db**2) * np.exp(-60 / 50)
    assert covariance[0, 3] == pytest.approx(kept, rel=1e-5)


@pytest.mark.parametrize("name", ["sinr_correlation_m", "sinr_common_std_db"])
@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, "50 m"])
def test_an_error_that_hangs_together_over_nonsense_is_refused(name: str, value: float | str) -> None:
    radio_map = build([[[0.0, 2.0, 4.0, 6.0]]])
    radio_map.attrs[name] = value
    with pytest.raises(InputError, match=f"attribute {name}"):
        validate(radio_map)


def test_a_simulation_that_is_right_but_for_level_and_spread_becomes_right_everywhere() -> None:
    truth = build([[[1.0, 5.0, 2.0, 8.0, -3.0, 0.5]]])
    wrong = truth.copy(deep=True)
    wrong["sinr_db"].values = 2.5 * truth["sinr_db"].values - 7
    measured = truth.copy(deep=True)
    measured["sinr_db"].values[0, 0, 4:] = NAN
    measured["blocked_reason"].values[0, 0, 4:] = 1
    result = calibrate(wrong, measured)
    assert result.cells == 4
    np.testing.assert_allclose(result.radio_map["sinr_db"].values, truth["sinr_db"].values, atol=1e-5)
    assert result.after.rmse_db == pytest.approx(0.0, abs=1e-6)
    # Nothing happens to what was given.
    assert wrong["sinr_db"].values[0, 0, 1] == 5.5
    assert "calibration_offset_db" not in wrong.attrs


def test_before_and_after_are_kept_with_the_map(tmp_path: Path) -> None:
    result = calibrate(build([[[0.0, 2.0, 4.0, 6.0]]]), build([[[10.0, 10.0, 14.0, 14.0]]]))
    save_map(result.radio_map, tmp_path / "map.nc")
    attributes = load_map(tmp_path / "map.nc").attrs
    assert attributes["calibration_offset_db"] == result.offset_db
    assert attributes["calibration_spread_factor"] == result.spread_factor
    assert attributes["calibration_mean_db"] == 3.0
    for when, fit in (("before", result.before), ("after", result.after)):
        for name, value in fit._asdict().items():
            assert attributes[f"calibration_{name}_{when}"] == value


def test_measurements_between_the_cells_are_interpolated_in_all_directions() -> None:
    measured = build([[[1.0, 2.0, 3.0], [2.0, 4.0, 6.0]]], x0_m=13.0, z_m=(37.0,))
    result = calibrate(slope(0.0, 5), measured)
    expected_db = 0.1 * np.array([13.0, 33, 53]) - 0.05 * np.array([[0.0], [20]]) + 0.2 * 37
    assert result.cells == 6
    assert result.before.mean_error_db == pytest.approx((expected_db - [[1, 2, 3], [2, 4, 6]]).mean(), abs=1e-5)
    assert result.before.spread_ratio == pytest.approx(expected_db.std() / np.std([1, 2, 3, 2, 4, 6]), rel=1e-5)


def test_measurements_outside_do_not_count() -> None:
    measured = build([[[0.0, 1.0, 5.0, 100.0, 100.0]], [[100.0] * 5]], z_m=(50.0, 60.0))
    result = calibrate(slope(0.0, 3), measured)
    assert result.cells == 3
    assert result.offset_db == pytest.approx(2.0 - (2.0 + 10.0), abs=1e-5)


@pytest.mark.parametrize("hole", range(5))
def test_an_unknown_cell_of_the_simulation_costs_no_other(hole: int) -> None:
    simulated_db = np.array([[[1.0, 2.0, 3.0, 4.0, 6.0]]])
    simulated_db[0, 0, hole] = NAN
    result = calibrate(build(simulated_db), build([[[0.0, 3.0, 1.0, 4.0, 9.0]]]))
    assert result.cells == 4
    assert np.isfinite(result.radio_map["sinr_db"].values).sum() == 4
    with pytest.raises(InputError, match="2 measured cells"):
        calibrate(build([[[1.0, 2.0, NAN, 4.0, 6.0]]]), build([[[0.0, 3.0, 1.0, 4.0]]], x0_m=10.0))


def test_filled_cells_are_no_measurements() -> None:
    measured = fill(build([[[0.0, 4.0, NAN, 9.0, 2.0]]]), 20.0)
    assert measured["filled"].values.sum() == 1
    assert calibrate(build([[[1.0, 2.0, 3.0, 4.0, 5.0]]]), measured).cells == 4


def test_maps_with_anchors_of_their_own_are_laid_over_each_other() -> None:
    latitude_deg, longitude_deg = to_degrees(-40.0, 0.0, HERE)
    there = Anchor(float(latitude_deg), float(longitude_deg))
    measured = build([[[0.0, 1.0, 5.0, 2.0]]], x0_m=60.0, z_m=(40.0,), anchor=there)
    plain = calibrate(slope(0.0, 6), build([[[0.0, 1.0, 5.0, 2.0]]], x0_m=20.0, z_m=(40.0,)))
    laid = calibrate(slope(0.0, 6, anchor=HERE), measured)
    assert laid.cells == plain.cells == 4
    assert laid.before == pytest.approx(plain.before, abs=1e-4)


@pytest.mark.parametrize(
    ("simulated", "measured", "message"),
    [
        (slope(0.0, 6), build([[[0.0, 1.0, 5.0]]], anchor=HERE), "one of the maps has an anchor and the other has none"),
        (slope(0.0, 6), build([[[0.0, 1.0, 5.0]]], x0_m=80.0), r"2 measured cells lie within .* at least 3"),
        (slope(0.0, 6), build([[[0.0, 1.0, 5.0]]], z_m=(20.0,)), "0 measured cells"),
        (build([[[3.0, 3.0, 3.0]]]), build([[[0.0, 1.0, 5.0]]]), "the same SINR in all measured cells"),
    ],
)
def test_what_cannot_be_fitted_is_refused_in_one_line(simulated: RadioMap, measured: RadioMap, message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        calibrate(simulated, measured)
    assert "\n" not in str(caught.value)


def test_what_a_stretched_sinr_no_longer_fits_is_stretched_or_left_out() -> None:
    sinr_db = np.array([[[0.0, 2.0, 4.0, 6.0]]])
    extra = {"sinr_spread_db": np.full(sinr_db.shape, 1.5), "rsrp_dbm": np.full((1, *sinr_db.shape), -80.0)}
    axes = {"x_m": 20.0 * np.arange(4), "y_m": [0.0], "z_m": [30.0]}
    simulated = make_map(sinr_db, **axes, source="test", optional=extra, sectors={"sector_name": ["a"]})
    result = calibrate(simulated, build([[[10.0, 10.0, 14.0, 14.0]]]))
    assert "rsrp_dbm" not in result.radio_map
    np.testing.assert_allclose(result.radio_map["sinr_spread_db"], 1.5 * result.spread_factor, rtol=1e-6)
    assert "rsrp_dbm" in simulated
    np.testing.assert_array_equal(simulated["sinr_spread_db"], 1.5)


def test_measurements_without_spread_are_refused() -> None:
    with pytest.raises(InputError, match="all measured cells have the same SINR"):
        calibrate(build([[[0.0, 2.0, 4.0, 6.0]]]), build([[[10.0] * 4]]))


@pytest.mark.parametrize("source", ["simulation", "ray tracing"])
def test_a_computed_map_is_no_measurement(source: str) -> None:
    computed = build([[[10.0, 10.0, 14.0, 14.0]]])
    computed.attrs["source"] = source
    with pytest.raises(InputError, match=f"comes from {source}, not from measurements"):
        calibrate(build([[[0.0, 2.0, 4.0, 6.0]]]), computed)
