"""From the settings of a map to the map: sites, progress, what a layout leaves out, the hold-out check of logs."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.experiment import build_map, holdout_of, layout_warning, log_options, make_measured_map, make_sites, maps
from cellpilot.maps import Anchor, anchor_of, save_map, simulate_map, write_sites
from cellpilot.maps.sources import simulated
from cellpilot.radio import ColumnAntenna, Deployment, hexagonal_deployment, simulate
from cellpilot.scenario import LogSettings, MapFile, MeasuredMap, SimulatedMap

HIGH = SimulatedMap(heights_m=(30.0, 100.0))
LOGS = tuple(Path(str(files("cellpilot").joinpath("data", f"synthetic_{height_m}m.csv"))) for height_m in (30, 50))
SEA = (0.01, 0.01)


def warning_of(settings: SimulatedMap) -> str | None:
    return layout_warning(make_sites(settings).deployment, settings)


def test_seven_sites_alone_are_too_good_and_the_advice_mends_it() -> None:
    text = warning_of(HIGH)
    assert text is not None
    found = re.fullmatch(
        r"7 sites alone are up to ([\d.]+) dB too good at 100 m \(mean ([\d.]+) dB\) .* add outer sites with `map\.rings` (\d+)",
        text,
    )
    assert found is not None
    most_db, mean_db, rings = float(found[1]), float(found[2]), int(found[3])
    # By the maps: the lattice of the warning lies in these cells.
    place = {
        "x_range_m": (-200.0, 200.0),
        "y_range_m": (-200.0, 200.0),
        "heights_m": (100.0,),
        "bin_m": 40.0,
        "points_per_side": 2,
    }
    alone, among = (simulate_map(hexagonal_deployment(each), **place)["sinr_db"].values for each in (1, 11))  # type: ignore[arg-type]
    assert mean_db == pytest.approx((alone - among).mean(), abs=0.5)
    assert mean_db < most_db < (alone - among).max() + 1.5
    assert warning_of(HIGH.model_copy(update={"rings": rings})) is None
    # The smallest number that does.
    assert rings > 2
    fewer = warning_of(HIGH.model_copy(update={"rings": rings - 1}))
    assert fewer is not None
    assert fewer.endswith(f"add outer sites with `map.rings` {rings}")


@pytest.mark.parametrize("distance_m", [2.0, 20.0, 150.0])
def test_of_a_dense_layout_no_number_of_rings_is_claimed(distance_m: float, monkeypatch: pytest.MonkeyPatch) -> None:
    most, make_deployment = [], maps.make_deployment

    def counted(settings: SimulatedMap) -> Deployment:
        # Before it is made: 2,500 rings of sites would not fit into memory.
        assert settings.rings <= 40
        most.append(settings.rings)
        return make_deployment(settings)

    monkeypatch.setattr(maps, "make_deployment", counted)
    text = warning_of(HIGH.model_copy(update={"inter_site_distance_m": distance_m}))
    assert text is not None
    assert "7 sites alone are up to" in text
    assert re.search(r"map\.rings` \d", text) is None
    assert max(most) == 40


def test_of_a_layout_as_large_as_any_that_is_tried_nothing_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    large = HIGH.model_copy(update={"rings": 40, "inter_site_distance_m": 20.0})
    deployment = make_sites(large).deployment
    monkeypatch.setattr(maps, "make_deployment", lambda settings: pytest.fail("another layout was made"))
    assert layout_warning(deployment, large) is None


@pytest.mark.parametrize("first", range(1, 41))
def test_the_smallest_number_is_found_in_few_trials(first: int) -> None:
    tried: list[int] = []

    def holds(number: int) -> bool:
        tried.append(number)
        return number >= first

    assert maps._smallest(holds, 0, 40) == first
    assert len(tried) <= 11
    assert max(tried) <= 40
    assert maps._smallest(lambda number: False, 0, 40) is None
    assert maps._smallest(lambda number: True, 40, 40) is None


@pytest.mark.parametrize(
    "changes",
    [
        {"rings": 5},
        {"heights_m": (30.0,)},
        {"load": 0.0},
    ],
)
def test_enough_rings_a_low_flight_or_idle_neighbours_need_no_more_sites(changes: dict[str, object]) -> None:
    assert warning_of(HIGH.model_copy(update=changes)) is None


def test_a_site_list_is_taken_as_it_is(tmp_path: Path) -> None:
    write_sites(hexagonal_deployment(), tmp_path / "sites.csv")
    assert warning_of(SimulatedMap(heights_m=(100.0,), sites=tmp_path / "sites.csv")) is None


def test_progress_rises_from_above_nothing_to_one_and_strips_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = SimulatedMap(heights_m=(30.0, 60.0), points_per_side=2, shadowing_seed=1)
    whole = build_map(settings)
    shares: list[float] = []
    # 20 rows of 20 x 2 x 4 points: three rows a strip.
    monkeypatch.setattr(simulated, "STRIP_POINTS", 500)
    in_strips = build_map(settings, progress=shares.append)
    assert shares == pytest.approx([0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1.0])
    assert in_strips.identical(whole)


def test_many_sectors_are_simulated_in_narrower_strips(monkeypatch: pytest.MonkeyPatch) -> None:
    shares: list[float] = []
    monkeypatch.setattr(simulated, "STRIP_LEVELS", 21 * 20 * 5)
    build_map(SimulatedMap(points_per_side=1), progress=shares.append)
    assert shares == pytest.approx([0.25, 0.5, 0.75, 1.0])


def test_too_many_sectors_for_the_memory_leave_their_powers_out(monkeypatch: pytest.MonkeyPatch) -> None:
    small = SimulatedMap(points_per_side=1)
    with_powers = build_map(small)
    monkeypatch.setattr(simulated, "MAX_RSRP_VALUES", 21 * 400 - 1)
    without = build_map(small)
    assert "rsrp_dbm" in with_powers
    assert without.identical(with_powers.drop_vars("rsrp_dbm"))


def test_the_power_of_every_sector_is_that_of_the_radio_model() -> None:
    radio_map = build_map(SimulatedMap(points_per_side=1, bin_m=100.0, heights_m=(30.0, 80.0)))
    x_m, y_m, z_m = (radio_map[axis].values for axis in "xyz")
    received = simulate(hexagonal_deployment(), x_m, y_m[:, None], z_m[:, None, None], every_sector=True)
    np.testing.assert_allclose(radio_map["rsrp_dbm"].values, received.sector_rsrp_dbm, atol=1e-4)


def test_sites_of_the_layout_have_no_names_and_those_of_a_list_their_own(tmp_path: Path) -> None:
    sites = make_sites(SimulatedMap(rings=0, anchor=(47.0, 8.0)))
    assert (sites.names, sites.anchor) == (None, Anchor(47.0, 8.0))
    assert sites.deployment.boresight_deg.tolist() == [30.0, 150.0, 270.0]
    antenna = ColumnAntenna(4, 0.5, 3.0, 1.0)
    names = ("north/a", "north/b", "north/c")
    listed = hexagonal_deployment(rings=0, boresights_deg=(0, 90, 200), power_dbm=40.0, antenna=antenna)
    write_sites(listed, tmp_path / "sites.csv", names, Anchor(47.0, 8.0))
    settings = SimulatedMap(sites=tmp_path / "sites.csv", anchor=(47.001, 8.0), noise_figure_db=5.0, points_per_side=1)
    read = make_sites(settings)
    assert (read.names, read.anchor) == (names, Anchor(47.001, 8.0))
    assert read.deployment.noise_figure_db == 5.0
    assert read.deployment.antenna == (antenna,) * 3
    # The anchor lies 111 m north of the mast.
    assert read.deployment.y_m == pytest.approx(-111.2, abs=0.2)
    radio_map = build_map(settings)
    assert radio_map["sector_name"].values.tolist() == list(names)
    assert anchor_of(radio_map) == read.anchor


def test_a_map_file_is_read_and_logs_are_gridded(tmp_path: Path) -> None:
    made = build_map(SimulatedMap(points_per_side=1))
    save_map(made, tmp_path / "map.nc")
    assert build_map(MapFile(path=tmp_path / "map.nc")).identical(made)
    logged = build_map(MeasuredMap(logs=LOGS, bin_m=80.0), Anchor(*SEA))
    assert anchor_of(logged) == Anchor(*SEA)
    assert logged["z"].values.tolist() == [30.0, 50.0]


def test_without_a_log_there_is_no_map() -> None:
    with pytest.raises(InputError, match=r"needs a measured log: give `map\.logs` FILE"):
        make_measured_map(LogSettings())


def test_columns_named_by_hand_and_limits_reach_the_reader() -> None:
    plain = log_options(LogSettings(max_accuracy_m=12.0, max_age_s=3.0))
    assert (plain.format, plain.max_accuracy_m, plain.max_age_s) == (None, 12.0, 3.0)
    columns = "lat=Breite,lon=Laenge,sinr=Guete,alt=Hoehe"
    named = log_options(LogSettings(columns=columns, altitude_unit="ft", altitude_reference="sea-level")).format
    assert named is not None
    assert (named.latitude, named.longitude, named.sinr.name) == ("Breite", "Laenge", "Guete")


@pytest.fixture
def masts(tmp_path: Path) -> Path:
    """A list of one site in the sea where the synthetic logs were flown."""
    write_sites(hexagonal_deployment(rings=0), tmp_path / "masts.csv", anchor=Anchor(*SEA))
    return tmp_path / "masts.csv"


def test_a_trend_comes_from_the_sites_and_reaches_the_holes(masts: Path) -> None:
    settings = MeasuredMap(logs=LOGS[:1], bin_m=80.0, fill="gaussian-process", fill_radius_m=120.0)
    plain, with_trend = (build_map(each) for each in (settings, settings.model_copy(update={"trend": masts})))
    filled = plain["filled"].values
    assert filled.sum() > 3
    assert (with_trend["filled"].values == filled).all()
    np.testing.assert_array_equal(with_trend["sinr_db"].values[~filled], plain["sinr_db"].values[~filled])
    assert np.abs(with_trend["sinr_db"].values - plain["sinr_db"].values)[filled].max() > 0.05


def test_the_hold_out_check_of_logs_names_every_method(masts: Path) -> None:
    settings = MeasuredMap(logs=LOGS, fill="gaussian-process", fill_radius_m=60.0)
    plain = holdout_of(settings, 40.0, 120.0)
    assert list(plain) == ["mean per height", "inverse distance", "Gaussian process"]
    with_trend = holdout_of(settings.model_copy(update={"trend": masts}), 40.0, 120.0)
    assert list(with_trend) == [*plain, "Gaussian process, trend"]
    assert {name: with_trend[name] for name in plain} == plain
    assert with_trend["Gaussian process, trend"] != plain["Gaussian process"]
    assert plain["Gaussian process"].rmse_db < plain["mean per height"].rmse_db
    # Neighbours within the radius that filling would use; any distance where it fills nothing.
    assert plain["inverse distance"].answered < 1
    assert holdout_of(settings.model_copy(update={"fill_radius_m": 0.0}), 40.0, 120.0)["inverse distance"].answered == 1
