"""Site lists on the command line: written, simulated, and refused when wrong."""

import csv
from pathlib import Path

import numpy as np
import pytest
from cli_tools import Cli, assert_refused, tree

from cellpilot.maps import load_map, read_sites
from cellpilot.radio import AntennaFile, write_antenna

COARSE = ("--map.bin-m", "100", "--map.points-per-side", "1")
CELLS = """\
LTE,272,5,40,128001,0,-8.40,51.90,1000,10,1,1,1,0
LTE,272,5,40,128002,0,-8.38,51.90,1000,30,1,1,1,0
LTE,272,5,40,179200,0,-8.35,51.92,1000,,1,1,1,0
GSM,272,5,40,7,0,-8.40,51.90,1000,10,1,1,1,0
"""
HEADER = "site_id,x_m,y_m,height_m,sector_id,azimuth_deg,electrical_tilt_deg,antenna,power_dbm,carrier_mhz,bandwidth_mhz,load"
SECTOR = 'A,0,0,25,1,90,6,"column(8,0.7)",46,1800,10,1'

WRONG_LINES = {
    "antenna": 'A,0,0,25,2,90,6,"column(10,0.8.1,-40)",46,1800,10,1',
    "n_vertical": 'A,0,0,25,2,90,6,"column(0,0.8,-40)",46,1800,10,1',
    "no.msi": "A,0,0,25,2,90,6,no.msi,46,1800,10,1",
    "bandwidth_mhz": 'A,0,0,25,2,90,6,"column(8,0.7)",46,1800,7,1',
    "carrier_mhz": 'A,0,0,25,2,90,6,"column(8,0.7)",46,1,10,1',
    "height_m": 'A,0,0,1000,2,90,6,"column(8,0.7)",46,1800,10,1',
    "load": 'A,0,0,25,2,90,6,"column(8,0.7)",46,1800,10,2',
    "azimuth_deg": 'A,0,0,25,2,north,6,"column(8,0.7)",46,1800,10,1',
    "x_m": 'A,inf,0,25,2,90,6,"column(8,0.7)",46,1800,10,1',
    "sector_id": SECTOR,
}

WRONG_SITES = [
    (["gone"], ["gone", "thesis-2d"]),
    (["ukm-30m"], ["ukm-30m", "no deployment"]),
    (["thesis-3d", "--opencellid", "272.csv"], ["thesis-3d", "--opencellid", "leave one of them out"]),
    (["--opencellid", "gone.csv"], ["gone.csv", "no such file"]),
    (["--opencellid", "latin.csv"], ["latin.csv, line 5", "UTF-8"]),
    (["--opencellid", "short.csv"], ["short.csv, line 5", "3 field(s)", "14"]),
    (["--opencellid", "two.csv"], ["two.csv", "2 operators", "272-1", "--operator"]),
    (["--opencellid", "272.csv", "--operator", "9-9"], ["no cells of operator 9-9"]),
    (["--opencellid", "272.csv", "--azimuths-deg", "400"], ["azimuths_deg", "400", "0..360"]),
    (["--opencellid", "272.csv", "--azimuths-deg", "0", "-10"], ["azimuths_deg", "-10", "0..360"]),
    (["--opencellid", "272.csv", "--azimuths-deg"], ["azimuths_deg", "empty"]),
    (["--opencellid", "272.csv", "--height-m", "1000"], ["height", "1000", "300"]),
    (["--opencellid", "272.csv", "--bandwidth-hz", "7e6"], ["bandwidth", "7 MHz"]),
    (["--opencellid", "272.csv", "--load", "2"], ["--load", "2"]),
    (["--azimuths-deg", "0", "180"], ["--azimuths-deg", "--opencellid"]),
    (["--operator", "272-5"], ["--operator", "--opencellid"]),
    (["--out", "."], [".", "folder"]),
]


@pytest.fixture
def desk(place: Path) -> Path:
    """The working directory with a site list, an OpenCelliD export and wrong ones."""
    (place / "sites.csv").write_text(f"{HEADER}\n{SECTOR}\n")
    (place / "272.csv").write_text(CELLS)
    (place / "two.csv").write_text(CELLS + "LTE,272,1,40,99999,0,-8.41,51.91,1000,10,1,1,1,0\n")
    (place / "short.csv").write_text(CELLS + "LTE,272,5\n")
    (place / "latin.csv").write_bytes(CELLS.encode() + b"LTE,272,5,\xe9\n")
    return place


def test_the_list_of_a_scenario_simulates_to_the_scenarios_own_map(place: Path, cli: Cli) -> None:
    result = cli("map", "sites", "--out", "deep/sites.csv")
    assert (result.code, result.out, result.err) == (0, "sites: deep/sites.csv\n", "")
    assert cli("map", "sites", "thesis-2d", "--out", "named.csv").code == 0
    assert (place / "named.csv").read_bytes() == (place / "deep" / "sites.csv").read_bytes()
    assert cli("map", "simulate", "thesis-2d", *COARSE, "--out", "own.nc").code == 0
    result = cli("map", "simulate", "--sites", "named.csv", *COARSE, "--out", "listed.nc")
    assert (result.code, result.out, result.err) == (0, "map: listed.nc\n", "")
    own, listed = (load_map(place / name) for name in ("own.nc", "listed.nc"))
    np.testing.assert_allclose(listed["sinr_db"].values, own["sinr_db"].values, atol=1e-4)
    assert listed["sector_name"].values.tolist()[:4] == ["0/0", "0/1", "0/2", "1/3"]


def test_a_list_is_simulated_however_it_is_given(desk: Path, cli: Cli) -> None:
    calls = {
        "apart": ["--sites", "sites.csv"],
        "joined": ["--sites=sites.csv"],
        "setting": ["--map.sites", "sites.csv"],
        "after": ["--map.load=1", "--sites=sites.csv"],
    }
    for name, call in calls.items():
        result = cli("map", "simulate", *call, *COARSE, "--out", f"{name}.nc")
        assert (result.code, result.out, result.err) == (0, f"map: {name}.nc\n", "")
    maps = [load_map(desk / f"{name}.nc") for name in calls]
    assert maps[0]["sector_name"].values.tolist() == ["A/1"]
    assert maps[0]["z"].values.tolist() == [30.0]
    for each in maps[1:]:
        np.testing.assert_array_equal(each["sinr_db"].values, maps[0]["sinr_db"].values)


@pytest.mark.parametrize("call", [["thesis-3d", "--sites=sites.csv"], ["--sites", "sites.csv", "thesis-3d"]])
def test_the_scenario_beside_a_list_counts_wherever_it_stands(desk: Path, cli: Cli, call: list[str]) -> None:
    assert cli("map", "simulate", *call, *COARSE, "--out", "new.nc").code == 0
    radio_map = load_map(desk / "new.nc")
    assert radio_map["z"].values.tolist() == [20.0, 40.0, 60.0, 80.0, 100.0]
    assert radio_map["sector_name"].values.tolist() == ["A/1"]


@pytest.mark.parametrize(
    ("call", "named"),
    [
        ([], ["a scenario is missing", "thesis-2d"]),
        (["--out", "new.nc"], ["a scenario is missing"]),
        (["--sitess=sites.csv"], ["a scenario is missing"]),
        (["gone", "--sites=sites.csv"], ["gone", "no such scenario"]),
        (["--sites=sites.csv", "gone"], ["gone", "no scenario"]),
        (["--sites"], ["--map.sites"]),
        (["--sites=gone.csv"], ["gone.csv", "no such file"]),
        (["--sites=sites.csv", "--map.rings", "2"], ["rings", "sites.csv"]),
    ],
    ids=lambda value: " ".join(value) or "nothing",
)
def test_a_wrong_call_of_simulate_makes_no_map(desk: Path, cli: Cli, call: list[str], named: list[str]) -> None:
    before = tree(desk)
    assert_refused(cli("map", "simulate", *call), *named)
    assert tree(desk) == before


@pytest.mark.parametrize("column", WRONG_LINES)
def test_a_wrong_list_is_refused_with_file_line_and_column(desk: Path, cli: Cli, column: str) -> None:
    (desk / "sites.csv").write_text(f"{HEADER}\n{SECTOR}\n{WRONG_LINES[column]}\n")
    before = tree(desk)
    for sites in (["--sites", "sites.csv"], ["--sites=sites.csv"]):
        assert_refused(cli("map", "simulate", *sites, *COARSE, "--out", "new.nc"), "sites.csv, line 3: ", column)
    assert tree(desk) == before


@pytest.mark.parametrize(("call", "named"), WRONG_SITES, ids=lambda value: " ".join(value))
def test_a_wrong_call_of_sites_writes_no_list(desk: Path, cli: Cli, call: list[str], named: list[str]) -> None:
    before = tree(desk)
    out = [] if "--out" in call else ["--out", "new.csv"]
    assert_refused(cli("map", "sites", *call, *out), *named)
    assert tree(desk) == before


def test_positions_from_opencellid_say_what_is_assumed_on_screen_and_in_every_line(desk: Path, cli: Cli) -> None:
    result = cli("map", "sites", "--opencellid", "272.csv", "--azimuths-deg", "0", "180", "--power-dbm", "43", "--out", "new.csv")
    assert (result.code, result.err) == (0, "")
    assert result.out.splitlines() == [
        "272.csv: 3 LTE cells of operator 272-5 at 2 sites, 1 cells of radio GSM left out",
        "assumed for every site: sectors at 0, 180 deg, 25 m, column of 10 elements at 7 deg downtilt, 43 dBm, 1800 MHz,"
        " 10 MHz wide, load 1",
        "sites: new.csv",
    ]
    with (desk / "new.csv").open(newline="") as file:
        lines = list(csv.DictReader(file))
    assert [line["note"] for line in lines] == ["assumed: everything but the position"] * 4
    assert [line["power_dbm"] for line in lines] == ["43.0"] * 4
    # The list can be simulated as it is: the note is left alone.
    anchor = read_sites(desk / "new.csv").anchor
    assert anchor is not None
    assert (anchor.latitude_deg, anchor.longitude_deg) == pytest.approx((51.91, (-8.385 - 8.35) / 2))
    assert cli("map", "simulate", "--sites=new.csv", *COARSE, "--out", "new.nc").code == 0
    assert load_map(desk / "new.nc")["sector_name"].values.tolist() == ["500/0", "500/1", "700/0", "700/1"]


def test_a_list_with_antenna_files_is_copied_without_touching_files_of_mine(desk: Path, cli: Cli) -> None:
    write_antenna(AntennaFile({}, 15.0, None, 0.0, np.zeros(360), np.zeros(360)), desk / "panel.msi")
    measured = SECTOR.replace("A,0,0,25,1", "A,0,0,25,2").replace('"column(8,0.7)"', "panel.msi")
    (desk / "sites.csv").write_text(f"{HEADER}\n{SECTOR}\n{measured}\n")
    (desk / "mine.toml").write_text('[map]\nsites = "sites.csv"\n')
    (desk / "copy-antenna-1.msi").write_text("my own measurements\n")
    assert cli("map", "sites", "mine.toml", "--out", "copy.csv").code == 0
    assert (desk / "copy-antenna-1.msi").read_text() == "my own measurements\n"
    with (desk / "copy.csv").open(newline="") as file:
        assert [line["antenna"] for line in csv.DictReader(file)] == ["column(8,0.7,-40.0)", "copy-antenna-2.msi"]
    maps = []
    for name in ("sites", "copy"):
        assert cli("map", "simulate", f"--sites={name}.csv", *COARSE, "--out", f"{name}.nc").code == 0
        maps.append(load_map(desk / f"{name}.nc")["sinr_db"].values)
    np.testing.assert_allclose(maps[0], maps[1], atol=1e-4)


@pytest.mark.parametrize(
    ("distance_m", "advice"),
    [("500", "--map.rings 4\n"), ("20", "how many is not known"), ("2", "how many is not known")],
)
def test_too_few_outer_sites_are_warned_of(place: Path, cli: Cli, distance_m: str, advice: str) -> None:
    high = ("--map.heights-m", "100", "--map.inter-site-distance-m", distance_m)
    result = cli("map", "simulate", "thesis-2d", *COARSE, *high, "--out", "new.nc")
    assert (result.code, result.out) == (0, "map: new.nc\n")
    assert result.err.startswith("warning: 7 sites alone are up to ")
    assert advice in result.err
    assert result.err.count("\n") == 1
