"""What `map info` says of a map."""

from dataclasses import replace
from datetime import date
from importlib.resources import files

import numpy as np
import pytest

from cellpilot.maps import Anchor, account_of, import_logs, make_map, simulate_map
from cellpilot.maps.calibrate import calibrate
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_RAY
from cellpilot.maps.words import described, share_below
from cellpilot.radio import hexagonal_deployment
from cellpilot.world import World

NAN = np.nan
AXES = {"x_m": 40.0 * np.arange(5), "y_m": 20.0 * np.arange(2), "z_m": [30.0, 50.0, 70.0]}


def test_every_figure_by_hand() -> None:
    sinr_db = np.array([[[0, 1, 2, 3, 4], [5, 6, 7, 8, NAN]], [[2.0] * 5, [9.0] * 5], [[NAN] * 5] * 2])
    std_db = np.zeros_like(sinr_db)
    std_db[1, 0], std_db[1, 1] = 3.0, 4.0
    filled = np.zeros(sinr_db.shape, bool)
    filled[1, 0, :3] = True
    blocked = np.isnan(sinr_db)
    blocked[1, 0, 0] = True
    spread_db = np.full_like(sinr_db, NAN)
    spread_db[0, 0, :3] = [1.0, 1.5, 4.0]
    radio_map = make_map(
        sinr_db,
        **AXES,
        source="test",
        sinr_std_db=std_db,
        filled=filled,
        blocked_reason=blocked.astype(int) + np.isnan(sinr_db),
        reasons=(INSIDE_BUILDING, NO_RAY),
        optional={"sinr_spread_db": spread_db},
    )
    assert list(described(radio_map, 3.0)) == [
        "5 x 2 x 3 cells of 40 x 20 m, source test, no model",
        "lies nowhere on Earth (no anchor)",
        "area x -20 to 180 m, y -10 to 30 m",
        "30 m: 9 free cells, 1 blocked (1 no ray arrives), 33.3% below 3 dB, median 4.0 dB (10 to 90 %: 0.8 to 7.2 dB),"
        " spread within a cell 1.5 dB",
        "50 m: 9 free cells, 1 blocked (1 inside a building), 44.4% below 3 dB, median 9.0 dB (10 to 90 %: 2.0 to 9.0 dB),"
        " 22% of the known ones filled, uncertain by 3.6 dB",
        "70 m: 0 free cells, 10 blocked (10 no ray arrives), nothing known",
        "all heights: 18 free cells, 38.9% below 3 dB",
        "error of the map: correlated over 50 m",
    ]


def test_free_cells_without_sinr_are_holes() -> None:
    sinr_db = np.full((3, 2, 5), 8.0)
    sinr_db[0, 0, :4] = NAN
    radio_map = make_map(sinr_db, **AXES, source="test", unknown="bad")
    lines = list(described(radio_map, 3.0))
    assert lines[3] == (
        "30 m: 10 free cells, 0 blocked, 40.0% below 3 dB (4 unknown and counted as below),"
        " median of the known 8.0 dB (10 to 90 %: 8.0 to 8.0 dB)"
    )
    assert "unknown" not in lines[4]
    assert lines[6] == "all heights: 30 free cells, 13.3% below 3 dB (4 unknown and counted as below)"


def test_a_simulation_names_its_sectors_and_place() -> None:
    deployment = hexagonal_deployment(rings=0, carrier_hz=[2e9, 8e8, 2e9])
    radio_map = simulate_map(deployment, points_per_side=1, anchor=Anchor(47.25, 8.5))
    lines = list(described(radio_map, 3.0))
    assert lines[0].endswith("source simulation, UMa-AV, LOS soft, no shadowing")
    assert lines[1] == "x = y = 0 at 47.250000, 8.500000"
    assert lines[2] == (
        "area x -200 to 200 m, y -200 to 200 m:"
        " --map.x-range-m -200 200 --map.y-range-m -200 200 --map.bin-m 20 --map.anchor 47.25 8.5"
    )
    assert lines[3] == "3 sectors on 800, 2000 MHz"


SYNTHETIC = [str(files("cellpilot").joinpath("data", f"synthetic_{height_m}m.csv")) for height_m in (30, 50)]


def test_an_imported_log_keeps_its_account() -> None:
    radio_map = import_logs(SYNTHETIC[:1])
    lines = list(described(radio_map, 3.0))
    assert lines[4] == "holes filled by inverse distance to measured cells of the same height within 80 m"
    assert lines[5] == "error of the map: correlated over 50 m"
    assert lines[6] == "measured on days that the logs do not tell"
    assert lines[7:] == account_of(radio_map).lines()
    assert "spread within a cell" in lines[3]


def test_the_share_below_is_that_of_the_world() -> None:
    """A cell that is blocked does not count, one that is free and unknown counts as below."""
    sinr_db = np.array([[[NAN, NAN, 1.0, 5.0, 6.0], [0.0, 7.0, 8.0, 9.0, 9.0]]] * 3)
    blocked = np.zeros(sinr_db.shape, bool)
    blocked[:, 1, 0] = True
    radio_map = make_map(sinr_db, **AXES, source="test", blocked_reason=blocked, unknown="bad")
    world = World.from_map(radio_map)
    below = share_below(radio_map, 0, 3.0)
    assert (below.free, below.below, below.unknown) == (9, 3, 2)
    assert below.share == pytest.approx((world.signal.mean_db[world.airspace.free_cells] < 3.0).mean())


@pytest.mark.parametrize(
    ("attributes", "line"),
    [
        ({"fill_method": "magic", "fill_radius_m": 0.0}, "holes not filled"),
        ({"fill_method": "magic", "fill_radius_m": 60.0}, "holes filled by magic within 60 m"),
        (
            {"fill_method": "magic", "fill_radius_m": 60.0, "trend": "sites.csv, UMa-AV"},
            "holes filled by magic within 60 m, departing from a simulation (sites.csv, UMa-AV)",
        ),
    ],
)
def test_how_holes_were_filled(attributes: dict[str, str | float], line: str) -> None:
    radio_map = make_map(np.ones((3, 2, 5)), **AXES, source="test", attributes=attributes)
    assert line in described(radio_map, 3.0)


def test_a_calibrated_map_says_what_was_done_to_it() -> None:
    truth = simulate_map(hexagonal_deployment(rings=0), points_per_side=1)
    simulated = truth.copy(deep=True)
    truth.attrs["source"] = "measured log"
    simulated["sinr_db"].values = 2 * truth["sinr_db"].values - 3
    result = calibrate(simulated, truth)
    line = (
        f"calibrated by measurements: offset {result.offset_db:+.2f} dB, spread x 0.500,"
        f" RMSE {result.before.rmse_db:.2f} dB before and 0.00 dB after"
    )
    assert line in described(result.radio_map, 3.0)


@pytest.mark.parametrize(
    ("days", "text"),
    [
        ([("2019-12-30", "2019-12-31"), ("2020-01-02", "2020-03-01")], "measured 2019-12-30 to 2020-03-01, 31 days ago"),
        ([("2020-03-31", "2020-03-31")] * 2, "measured 2020-03-31, 1 day ago"),
        ([("2020-03-31", "2020-03-31"), None], "measured on days that the logs do not tell"),
    ],
)
def test_the_age_counts_from_the_last_day_of_measurements(days: list[tuple[str, str] | None], text: str) -> None:
    radio_map = import_logs(SYNTHETIC)
    account = account_of(radio_map)
    logs = tuple(replace(log, days=days_of_log) for log, days_of_log in zip(account.logs, days, strict=True))
    radio_map.attrs["import_account"] = replace(account, logs=logs).to_json()
    assert text in described(radio_map, 3.0, today=date(2020, 4, 1))
