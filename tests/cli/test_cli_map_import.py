"""`map import` and `map raytrace` on the command line: logs of any kind, hold-out, saved Sionna maps, options without effect."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from cli_tools import Cli

from cellpilot.maps import load_map

COLUMNS = "lat=la,lon=lo,alt=height_ft,sinr=snr"


@pytest.fixture
def logs(place: Path) -> Path:
    """The synthetic logs, one of unknown kind with feet above take-off, one without unit, and two saved Sionna maps."""
    for height in ("30m", "50m"):
        (place / f"{height}.csv").write_bytes(files("cellpilot").joinpath("data", f"synthetic_{height}.csv").read_bytes())
    rows = [f"47.{i // 6:04d},8.{i % 6:04d},100,{i % 9}" for i in range(36)]
    (place / "own.csv").write_text("\n".join(["la,lo,height_ft,snr", *rows]))
    (place / "bare.csv").write_text("\n".join(["la,lo,height,snr", *rows]))
    centres_m = np.stack(np.broadcast_arrays(np.arange(3) * 20.0, np.arange(2)[:, None] * 20.0, 30.0), axis=-1)
    gain = np.geomspace(1e-10, 1e-8, 12).reshape(2, 2, 3)
    row = 'a,{},25,1,90,7,"column(10,0.8)",46,2000,10'
    for name, columns, where in (("metres", "x_m,y_m", "0,0"), ("far", "latitude,longitude", "-40.0,100.0")):
        header = (
            f"site_id,{columns},height_m,sector_id,azimuth_deg,electrical_tilt_deg,antenna,power_dbm,carrier_mhz,bandwidth_mhz"
        )
        (place / f"{name}.csv").write_text(f"{header}\n{row.format(where)}\n")
    np.savez(place / "gain.npz", path_gain=gain, cell_centers=centres_m)
    np.savez(place / "sinr.npz", sinr=1e9 * gain, cell_centers=centres_m)
    return place


def test_hold_out_tells_the_error_of_each_method(logs: Path, cli: Cli) -> None:
    blocks = ("--holdout", "--holdout-bin-m", "20", "--holdout-block-m", "60")
    result = cli("map", "import", "30m.csv", "50m.csv", "--out", "new.nc", *blocks)
    assert result.code == 0, result.err
    rows = {line.split("│")[1].strip(): line.split("│")[2:6] for line in result.out.splitlines() if "%" in line and "│" in line}
    assert list(rows) == ["mean per height", "inverse distance", "Gaussian process"]
    errors_db = [float(row[0]) for row in rows.values()]
    assert all(0 < error_db < 30 for error_db in errors_db)
    assert len(set(errors_db)) == 3
    assert load_map(logs / "new.nc").attrs["bin_m"] == 40.0  # the map itself is that without a hold-out


def test_a_log_of_unknown_kind_in_feet(logs: Path, cli: Cli) -> None:
    call = ("map", "import", "own.csv", "--columns", COLUMNS, "--altitude-reference", "take-off", "--bin-m", "20")
    result = cli(*call, "--out", "own.nc")
    assert result.code == 0, result.err
    assert "named columns) at 30.48 m: 36 lines, 36 SINR samples kept" in result.out
    assert load_map(logs / "own.nc")["z"].values.tolist() == [30.0]
    stated = cli("map", "import", "bare.csv", "--columns", COLUMNS.replace("_ft", ""), "--altitude", "44", "--out", "stated.nc")
    assert stated.code == 0, stated.err  # one height is stated: nobody has to say what the column is
    assert load_map(logs / "stated.nc")["z"].values.tolist() == [44.0]


def test_a_saved_sionna_map_says_what_was_taken_for_the_network(logs: Path, cli: Cli) -> None:
    result = cli("map", "import", "gain.npz", "--receiver.power-dbm", "40", "--out", "new.nc")
    assert result.code == 0, result.err
    assert "taken for all transmitters: 40 dBm, 3500 MHz" in result.out
    assert "40 dBm" in load_map(logs / "new.nc").attrs["receiver"]
    assert "taken for" not in cli("map", "import", "sinr.npz", "--out", "other.nc").out


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["own.csv"], ["own.csv", "unknown kind", "--columns"]),
        (["own.csv", "--columns", COLUMNS], ["height_ft", "--altitude-reference"]),
        (["bare.csv", "--columns", COLUMNS.replace("_ft", "")], ["'height'", "metres or feet", "--altitude-unit"]),
        (
            ["own.csv", "--columns", COLUMNS, "--altitude-unit", "m", "--altitude-reference", "take-off"],
            ["height_ft", "is in ft"],
        ),
        (["own.csv", "--columns", "lat=la,lon=lo,sinr=snr", "--altitude-unit", "ft"], ["--altitude-unit ft", "not read"]),
        (["30m.csv", "--altitude-unit", "ft"], ["altitude_unit", "columns"]),
        (["30m.csv", "--ground-altitude-m", "300"], ["altitude of the ground", "no log counts from"]),
        (["30m.csv", "--fill", "gaussian-process", "--fill-radius-m", "0"], ["fill_radius_m is 0"]),
        (["30m.csv", "--trend-environment", "RMa-AV"], ["trend_environment", "site list"]),
        (["30m.csv", "--holdout-block-m", "30"], ["--holdout-block-m", "--holdout"]),
        (["30m.csv", "--receiver.load", "0.5"], ["--receiver", ".npz"]),
        (["30m.csv", "gain.npz"], ["gain.npz", "apart"]),
        (["gain.npz", "--bin-m", "20"], ["--bin-m", ".npz"]),
        (["sinr.npz", "--receiver.load", "0.5"], ["sinr.npz", "load", "without effect"]),
        (["gain.npz", "--receiver.bandwidth-hz", "7e6"], ["bandwidth is 7 MHz"]),
        (["gain.npz", "--receiver.power-dbm", "5000"], ["--receiver.power-dbm", "5000"]),
        ([], ["no file given"]),
        (["30m.csv", "--altitude", "99999"], ["99999", "10000"]),
        (["30m.csv", "--mask", "40", "10", "50"], ["40.000000, 10.000000", "holds no sample"]),
        (["30m.csv", "--holdout", "--holdout-block-m", "5"], ["5 m", "smaller than cells"]),
        (["30m.csv", "--holdout", "--holdout-block-m", "50000"], ["block(s) of 50000 m", "at least 5"]),
        (["30m.csv", "--fill", "gaussian-process", "--trend", "metres.csv"], ["metres.csv", "in metres", "degrees"]),
        (["30m.csv", "--fill", "gaussian-process", "--trend", "far.csv"], ["far.csv", "km from the area"]),
        (["own.csv", "--columns", COLUMNS, "--altitude-reference", "sea-level", "--ground-altitude-m", "90"], ["below height 0"]),
    ],
)
def test_what_contradicts_itself_or_does_nothing_is_refused(logs: Path, cli: Cli, arguments: list[str], words: list[str]) -> None:
    result = cli("map", "import", *arguments, "--out", "never.nc")
    assert (result.code, result.out) == (2, "")
    assert len(result.err.splitlines()) == 1
    for word in words:
        assert word in result.err
    assert not (logs / "never.nc").exists()


@pytest.mark.parametrize(
    "arguments",
    [
        ["import", "30m.csv", "--out", "30m.csv"],
        ["import", "30m.csv", "--fill", "gaussian-process", "--trend", "far.csv", "--out", "far.csv"],
        ["simulate", "--sites", "far.csv", "--out", "far.csv"],
        ["convert", "plain.nc", "plain.nc"],
        ["calibrate", "plain.nc", "--to", "blocked.nc", "--out", "blocked.nc"],
        ["raytrace", "--map.sites", "metres.csv", "--out", "metres.csv"],
        ["sites", "tiny.toml", "--out", "far.csv"],
    ],
)
def test_what_is_read_is_not_overwritten(logs: Path, cli: Cli, arguments: list[str]) -> None:
    before = {path.name: path.read_bytes() for path in logs.iterdir() if path.is_file()}
    result = cli("map", *arguments)
    assert (result.code, result.out) == (2, "")
    assert arguments[-1] in result.err
    assert {path.name: path.read_bytes() for path in logs.iterdir() if path.is_file()} == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--map.los", "nlos"], ["--map.los", "simulation"]),
        (["--map.points-per-side", "2"], ["--map.points-per-side"]),
        (["--map.sites", "sites.csv"], ["sites.csv", "--map.anchor"]),
    ],
)
def test_ray_tracing_takes_no_setting_of_the_simulation(place: Path, cli: Cli, arguments: list[str], words: list[str]) -> None:
    row = 'a,47.0,8.0,25,1,90,7,"column(10,0.8)",46,2000,10'
    header = "site_id,latitude,longitude,height_m,sector_id,azimuth_deg,electrical_tilt_deg,antenna,power_dbm"
    header += ",carrier_mhz,bandwidth_mhz"
    (place / "sites.csv").write_text(f"{header}\n{row}\n")
    result = cli("map", "raytrace", *arguments, "--out", "never.nc")
    assert (result.code, result.out) == (2, "")
    for word in words:
        assert word in result.err
    assert not (place / "never.nc").exists()
