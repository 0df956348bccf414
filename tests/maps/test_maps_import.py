"""From logs to a map: independence of order and files, the hover mask, the account; synthetic and real logs."""

import random
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from maps_logs import HEADER, WriteLog

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, ImportAccount, RadioMap, account_of, anchor_of, import_logs, load_map, read_log, save_map
from cellpilot.maps.hover import densest_disc
from cellpilot.maps.reasons import blocked_cells

SYNTHETIC = [Path(str(files("cellpilot").joinpath("data", f"synthetic_{height_m}m.csv"))) for height_m in (30, 50)]
UKM = Path(__file__).parents[2].parent / "shared" / "data" / "ukm"


def shuffled(path: Path, folder: Path, seed: int) -> Path:
    header, *lines = path.read_text(encoding="utf-8-sig").splitlines()
    random.Random(seed).shuffle(lines)
    copy = folder / path.name
    copy.write_text("\n".join([header, *lines]), encoding="utf-8")
    return copy


def halves(path: Path, folder: Path) -> list[Path]:
    header, *lines = path.read_text(encoding="utf-8-sig").splitlines()
    parts = []
    for number in (0, 1):
        parts.append(folder / f"part{number}_{path.name}")
        parts[-1].write_text("\n".join([header, *lines[number::2]]), encoding="utf-8")
    return parts


def assert_same_variables(one: RadioMap, other: RadioMap) -> None:
    xr.testing.assert_identical(one.drop_attrs(deep=False), other.drop_attrs(deep=False))
    assert anchor_of(one) == anchor_of(other)


@pytest.fixture(scope="module")
def synthetic() -> RadioMap:
    return import_logs(SYNTHETIC)


def test_synthetic_map_has_good_and_bad_cells(synthetic: RadioMap) -> None:
    for level in synthetic["sinr_db"].values:
        known_db = level[~np.isnan(level)]
        assert 0.15 < (known_db < -3).mean() < 0.6
    assert synthetic["z"].values.tolist() == [30, 50]
    assert (synthetic["sinr_std_db"].values[synthetic["count"].values > 0] > 0).all()


def test_the_map_finds_the_field_again(synthetic: RadioMap) -> None:
    from make_synthetic_logs import TAKE_OFF, field_db

    from cellpilot.maps import to_degrees, to_local

    anchor = anchor_of(synthetic)
    assert anchor is not None
    place = np.meshgrid(synthetic["x"].values, synthetic["y"].values)
    x_m, y_m = to_local(*to_degrees(*place, anchor), TAKE_OFF)
    for iz, height_m in enumerate(synthetic["z"].values):
        error_db = synthetic["sinr_db"].values[iz] - field_db(x_m, y_m, height_m)
        measured, filled = synthetic["count"].values[iz] > 0, synthetic["filled"].values[iz]
        assert np.sqrt(np.mean(error_db[measured] ** 2)) < 1.5
        assert np.sqrt(np.mean(error_db[filled] ** 2)) < 1.5 * synthetic["sinr_std_db"].values[iz][filled][0]


def test_order_of_lines_and_files_changes_nothing(synthetic: RadioMap, tmp_path: Path) -> None:
    again = import_logs([shuffled(path, tmp_path, 7) for path in reversed(SYNTHETIC)])
    assert again.identical(synthetic)
    assert import_logs(SYNTHETIC).identical(synthetic)


def test_splitting_a_file_changes_nothing(tmp_path: Path) -> None:
    whole = import_logs(SYNTHETIC[:1])
    parts = import_logs(halves(SYNTHETIC[0], tmp_path), altitude_m=30.0)
    assert_same_variables(whole, parts)
    assert account_of(parts).kept == account_of(whole).kept


def test_one_altitude_for_each_file(synthetic: RadioMap) -> None:
    assert import_logs(SYNTHETIC, altitude_m=[10.0, 20.0])["z"].values.tolist() == [10, 20]
    with pytest.raises(InputError, match=r"1 altitudes for 2 log"):
        import_logs(SYNTHETIC, altitude_m=[10.0])


def test_hover_is_found_left_out_and_recorded(synthetic: RadioMap) -> None:
    account = account_of(synthetic)
    assert account.mask_found
    assert account.mask is not None
    latitude_deg, longitude_deg, radius_m = account.mask
    assert (latitude_deg, longitude_deg) == pytest.approx((0.01, 0.01), abs=1.5e-4)
    assert radius_m == 25
    assert 0.15 < account.masked / account.kept < 0.25
    assert synthetic.attrs["masked_count"] == account.masked
    assert (synthetic.attrs["mask_latitude_deg"], synthetic.attrs["mask_longitude_deg"]) == (latitude_deg, longitude_deg)
    assert synthetic["count"].values.sum() == account.kept - account.masked


def test_without_mask_the_same_bins_hold_all_samples(synthetic: RadioMap) -> None:
    everything = import_logs(SYNTHETIC, mask=None)
    assert everything["x"].identical(synthetic["x"])
    assert everything["y"].identical(synthetic["y"])
    assert everything["count"].values.sum() == account_of(everything).kept
    more = everything["count"].values > synthetic["count"].values
    assert 1 <= more[0].sum() <= 9
    assert "mask_radius_m" not in everything.attrs
    assert "mask: none" in account_of(everything).lines()


def test_a_mask_can_be_given() -> None:
    dataset = import_logs(SYNTHETIC, mask=(0.012, 0.010, 60.0))
    account = account_of(dataset)
    assert not account.mask_found
    samples = [table[np.isfinite(table.sinr_db)] for table, _ in map(read_log, SYNTHETIC)]
    north_m = np.concatenate([(s.latitude_deg - 0.012) * 110574.3 for s in samples])
    east_m = np.concatenate([(s.longitude_deg - 0.010) * 111319.5 for s in samples])
    assert account.masked == (np.hypot(north_m, east_m) <= 60).sum() > 0


def test_even_flights_and_short_logs_are_no_hover() -> None:
    along_deg = 0.01 + np.arange(400) * 10 / 110574
    assert not densest_disc(along_deg, np.full(400, 0.01))[1]
    assert not densest_disc(along_deg[:3], np.full(3, 0.01))[1]
    at_start = np.concatenate([np.full(60, 0.01), along_deg])
    disc, hovering = densest_disc(at_start, np.full(460, 0.01))
    assert hovering
    assert disc.holds(np.array([0.01]), np.array([0.01])).all()


def test_ties_go_to_the_southwest() -> None:
    latitude_deg, longitude_deg = np.array([0.02, 0.01, 0.01]), np.array([0.01, 0.03, 0.02])
    disc, _ = densest_disc(latitude_deg, longitude_deg)
    assert (disc.latitude_deg, disc.longitude_deg) == (0.01, 0.02)


def test_an_anchor_can_be_given(synthetic: RadioMap) -> None:
    anchor = Anchor(0.011, 0.009, 12.0)
    dataset = import_logs(SYNTHETIC, anchor=anchor)
    assert anchor_of(dataset) == anchor
    assert (dataset["x"].values % 40 == 20).all()
    assert dataset["count"].values.sum() == synthetic["count"].values.sum()


def test_unknown_bad_and_no_filling() -> None:
    bad = import_logs(SYNTHETIC, unknown="bad")
    assert not blocked_cells(bad).any()
    assert sum(level.bad for level in account_of(bad).levels) == np.isnan(bad["sinr_db"].values).sum() > 0
    unfilled = import_logs(SYNTHETIC, fill_radius_m=0.0)
    assert not unfilled["filled"].values.any()
    assert np.array_equal(blocked_cells(unfilled), unfilled["count"].values == 0)


def test_standard_error_of_few_samples_is_never_zero(write_log: WriteLog) -> None:
    places = [0.01, 0.01, 0.01, 0.011, 0.011, 0.012]
    path = write_log([f"t,{p},0.01,,{v}" for p, v in zip(places, [1.0, 2.0, 3.0, 5.0, 5.0, 9.0], strict=True)])
    dataset = import_logs([path], fill_radius_m=0.0)
    count, std_db = dataset["count"].values.ravel(), dataset["sinr_std_db"].values.ravel()
    pooled = (2 * 1.0 + 1 * 0.0) / 3
    expected = {3: np.sqrt((2 * 1.0 + pooled) / 9), 2: np.sqrt(pooled / 4), 1: np.sqrt(pooled)}
    for n, value in expected.items():
        assert std_db[count == n] == pytest.approx([value], rel=1e-6)


def test_account_survives_the_file_and_reads_well(synthetic: RadioMap, tmp_path: Path) -> None:
    save_map(synthetic, tmp_path / "map.nc")
    loaded = load_map(tmp_path / "map.nc")
    xr.testing.assert_identical(loaded, synthetic)
    account = account_of(loaded)
    assert account == ImportAccount.from_json(account.to_json()) == account_of(synthetic)
    text = account.lines()
    assert text[0].startswith(
        "synthetic_30m.csv (drive-test export) at 30 m: 1091 lines, 519 SINR samples kept, 389 with RSRP only, 2 notes"
    )
    assert "hover found" in text[2]
    level = account.levels[0]
    assert level.measured + level.filled + level.blocked + level.bad == synthetic["count"].values[0].size
    for log in account.logs:
        assert log.rows == log.kept + log.rsrp_rows + sum(log.dropped.values())


def test_a_map_from_elsewhere_has_no_account(small_map: RadioMap) -> None:
    with pytest.raises(InputError, match="import_account"):
        account_of(small_map)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"mask": "hover"}, "the mask is 'hover'"),
        ({"mask": (0.01, 0.01, 0.0)}, "mask's radius is 0"),
        ({"mask": (95.0, 0.01, 10.0)}, "latitude is 95"),
        ({"mask": (0.01, 0.01, 1e5)}, "holds all 1038 samples"),
        ({"bin_m": -1.0}, "bin size is -1"),
        ({"bin_m": 1e5}, "has 1 cell; a flight needs"),
        ({"fill_radius_m": -1.0}, "fill radius is -1"),
        ({"unknown": "perhaps"}, "'perhaps'"),
        ({"bin_m": 0.001}, "too many bins"),
    ],
)
def test_wrong_settings_are_refused(settings: dict[str, object], message: str) -> None:
    if settings.get("bin_m") == 1e5:
        settings = settings | {"altitude_m": 30.0, "anchor": Anchor(0.0, 0.0)}  # one bin in all
    with pytest.raises(InputError, match=message):
        import_logs(SYNTHETIC, **settings)  # type: ignore[arg-type]


def test_no_log_and_the_same_log_twice() -> None:
    with pytest.raises(InputError, match="no log given"):
        import_logs([])
    with pytest.raises(InputError, match="given twice"):
        import_logs([SYNTHETIC[0], SYNTHETIC[0].parent / ".." / "data" / SYNTHETIC[0].name])


def test_a_stray_position_is_refused_not_gridded(write_log: WriteLog) -> None:
    far = write_log(["t,0.01,0.01,,1", "t,0.011,0.01,,2", "t,60.0,120.0,,3"], header=HEADER)
    with pytest.raises(
        InputError, match=r"line 4: latitude 60, longitude 120 lies 11,\d* km from the middle of the log.*exchanged"
    ):
        import_logs([far])
    near = write_log(["t,0.01,0.01,,1", "t,0.011,0.01,,2", "t,1.5,0.9,,3"], header=HEADER)
    with pytest.raises(InputError, match="stray positions"):
        import_logs([near], bin_m=1.0)


class TestMeasured:
    """The numbers that the collection of the logs states, at 40 m bins with the hover masked."""

    pytestmark = pytest.mark.shared

    @pytest.mark.parametrize(("height_m", "below_3", "below_minus_3"), [(20, 0.79, 0.32), (30, 0.82, 0.44), (50, 0.955, 0.57)])
    def test_share_of_bins_below_the_threshold(self, height_m: int, below_3: float, below_minus_3: float) -> None:
        dataset = import_logs([UKM / f"{height_m}m.csv"])
        mean_db = dataset["sinr_db"].values[dataset["count"].values > 0]
        # The origin of the stated bins is not known; moving it moves the shares by up to 0.03.
        assert (mean_db < 3).mean() == pytest.approx(below_3, abs=0.03)
        assert (mean_db < -3).mean() == pytest.approx(below_minus_3, abs=0.03)

    def test_hover_at_the_stated_place(self) -> None:
        account = account_of(import_logs([UKM / f"{height_m}m.csv" for height_m in (20, 30, 50)]))
        assert account.mask_found
        assert account.mask is not None
        assert account.mask[:2] == pytest.approx((2.92284, 101.77107), abs=5e-5)
        assert account.masked / account.kept == pytest.approx(0.21, abs=0.02)

    def test_shuffled_lines_give_the_same_map(self, tmp_path: Path) -> None:
        paths = [UKM / f"{height_m}m.csv" for height_m in (20, 30)]
        assert import_logs([shuffled(path, tmp_path, 1) for path in paths]).identical(import_logs(paths))

    def test_split_file_gives_the_same_map(self, tmp_path: Path) -> None:
        parts = import_logs(halves(UKM / "50m.csv", tmp_path), altitude_m=50.0)
        assert_same_variables(parts, import_logs([UKM / "50m.csv"]))

    def test_six_heights(self) -> None:
        dataset = import_logs(sorted(UKM.glob("*m.csv")))
        assert dataset["z"].values.tolist() == [20, 25, 30, 35, 40, 50]
        spread_db = dataset["sinr_spread_db"].values
        assert 1.0 < np.nanmedian(spread_db) < 1.6
