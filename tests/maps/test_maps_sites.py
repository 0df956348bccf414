"""Site lists and OpenCelliD files: what is read, that nothing is lost on the way, what is refused."""

import csv
import gzip
from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError, RangeError
from cellpilot.maps import Anchor, AssumedSectors, read_opencellid, read_sites, simulate_map, to_local, write_sites
from cellpilot.radio import (
    AntennaFile,
    ColumnAntenna,
    Deployment,
    PatternAntenna,
    hexagonal_deployment,
    received_power_dbm,
    simulate,
    write_antenna,
)

ROW = {
    "site_id": "A", "latitude": "51.9", "longitude": "-8.4", "height_m": "30", "sector_id": "1", "azimuth_deg": "90",
    "mechanical_tilt_deg": "2", "electrical_tilt_deg": "6", "antenna": "column(8,0.7)", "power_dbm": "46", "carrier_mhz": "1800",
    "bandwidth_mhz": "20", "load": "0.5",
}  # fmt: skip
POINTS = (np.linspace(-300, 300, 7), np.linspace(-200, 350, 7)[:, None], np.array([20.0, 60.0])[:, None, None])


def write(path: Path, rows: list[dict[str, str]]) -> Path:
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_the_default_deployment_through_its_site_list(tmp_path: Path) -> None:
    built_in = hexagonal_deployment()
    write_sites(built_in, tmp_path / "sites.csv")
    read = read_sites(tmp_path / "sites.csv").deployment
    a, b = (simulate(deployment, *POINTS, shadowing_seed=3) for deployment in (built_in, read))
    np.testing.assert_allclose(a.sinr_db, b.sinr_db, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(a.serving_sector, b.serving_sector)
    np.testing.assert_array_equal(built_in.boresight_deg, read.boresight_deg)


def test_a_list_in_degrees_comes_back_where_it_was(tmp_path: Path) -> None:
    anchor = Anchor(47.05, 8.3)
    deployment = hexagonal_deployment(power_dbm=np.linspace(40, 48, 21), load=np.linspace(0, 1, 21))
    write_sites(deployment, tmp_path / "sites.csv", anchor=anchor)
    read = read_sites(tmp_path / "sites.csv", anchor)
    np.testing.assert_allclose(read.deployment.x_m, deployment.x_m, atol=1e-6)
    np.testing.assert_allclose(read.deployment.y_m, deployment.y_m, atol=1e-6)
    np.testing.assert_array_equal(read.deployment.load, deployment.load)
    # Without an anchor x = y = 0 is the middle of the extent.
    middle = read_sites(tmp_path / "sites.csv")
    assert middle.anchor == pytest.approx(anchor, abs=1e-9) or np.allclose(to_local(47.05, 8.3, middle.anchor), 0, atol=1e-3)  # type: ignore[arg-type]


def test_every_column_counts(tmp_path: Path) -> None:
    rows = [
        ROW,
        ROW | {"sector_id": "2", "azimuth_deg": "0", "load": "", "mechanical_tilt_deg": ""},
        ROW | {"site_id": "B", "longitude": "-8.39"},
    ]
    found = read_sites(write(tmp_path / "sites.csv", rows))
    deployment = found.deployment
    assert found.names == ("A/1", "A/2", "B/1")
    assert deployment.boresight_deg.tolist() == [0.0, 90.0, 0.0]
    assert deployment.load.tolist() == [0.5, 1.0, 0.5]
    assert deployment.site.tolist() == [0, 0, 1]
    assert deployment.carrier_hz.tolist() == [1.8e9] * 3
    assert deployment.bandwidth_hz.tolist() == [20e6] * 3
    assert deployment.antenna[0] == ColumnAntenna(8, 0.7, 6.0, 2.0, -40.0)
    assert deployment.antenna[1] == ColumnAntenna(8, 0.7, 6.0, 0.0, -40.0)
    east_m = deployment.x_m[2] - deployment.x_m[0]
    assert east_m == pytest.approx(0.01 * 68_800, rel=0.01)
    names = simulate_map(deployment, names=found.names, anchor=found.anchor)["sector_name"].values
    assert names.tolist() == ["A/1", "A/2", "B/1"]


def test_antenna_files_beside_the_list(tmp_path: Path) -> None:
    vertical_db = np.round(30 * np.abs(np.sin(np.radians(np.arange(360) - 4) / 2)), 2)
    write_antenna(AntennaFile({"NAME": "x"}, 15.0, None, 4.0, np.zeros(360), vertical_db), tmp_path / "x.msi")
    rows = [ROW | {"antenna": "x.msi", "electrical_tilt_deg": tilt, "sector_id": f"s{tilt}"} for tilt in ("", "7")]
    deployment = read_sites(write(tmp_path / "sites.csv", rows)).deployment
    as_measured, tilted = deployment.antenna
    assert isinstance(as_measured, PatternAntenna)
    assert isinstance(tilted, PatternAntenna)
    assert (as_measured.downtilt_deg, tilted.downtilt_deg) == (4.0, 7.0)
    write_sites(deployment, tmp_path / "again" / "sites.csv")
    again = read_sites(tmp_path / "again" / "sites.csv").deployment
    points = (100.0, 40.0, [20.0, 80.0])
    np.testing.assert_allclose(received_power_dbm(again, *points), received_power_dbm(deployment, *points), atol=1e-9)
    assert len(list((tmp_path / "again").glob("*.msi"))) == 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"site_id": ""}, "site_id is empty; expected a name"),
        ({"azimuth_deg": ""}, "azimuth_deg is empty; expected a number from 0 to 360 deg"),
        ({"azimuth_deg": "361"}, "azimuth_deg is 361; expected a number from 0 to 360 deg"),
        ({"height_m": "1000"}, "height_m is 1000; expected a number from 1.5 to 300 m"),
        ({"height_m": "1"}, "height_m is 1; expected a number from 1.5 to 300 m"),
        ({"antenna": "colum(8)"}, "antenna is 'colum(8)'; expected column("),
        ({"antenna": "column(10,0.8.1,-40)"}, "antenna is 'column(10,0.8.1,-40)'; expected column(ELEMENTS,SPACING,FLOOR_DB)"),
        ({"antenna": "column(10,-,-40)"}, "antenna is 'column(10,-,-40)'; expected column("),
        ({"antenna": "column(1e1,0.8)"}, "antenna is 'column(1e1,0.8)'; expected column("),
        ({"antenna": "column(" + "9" * 5000 + ",0.8)"}, "antenna is 'column(999"),
        ({"antenna": "column(0,0.8,-40)"}, "antenna is 'column(0,0.8,-40)': n_vertical is 0; expected a whole number"),
        ({"antenna": "column(8,0)"}, "antenna is 'column(8,0)': spacing_wavelengths is 0.0; expected a number above 0"),
        ({"antenna": "column(8,0.7,-1e999)"}, "antenna is 'column(8,0.7,-1e999)': array-factor floor is -inf"),
        ({"antenna": "broken.msi"}, "antenna is 'broken.msi': "),
        ({"antenna": "flat.msi", "electrical_tilt_deg": "-60"}, "antenna is 'flat.msi': electrical tilt is -100 deg"),
        ({"antenna": "gone.msi"}, "antenna is 'gone.msi'; expected column("),
        ({"antenna": "a" * 5000}, "antenna is 'aaa"),
        ({"antenna": ""}, "antenna is empty"),
        ({"electrical_tilt_deg": ""}, "electrical_tilt_deg is empty; expected the downtilt of the column"),
        ({"electrical_tilt_deg": "91"}, "electrical_tilt_deg is 91; expected a number from -90 to 90 deg"),
        ({"mechanical_tilt_deg": "-91"}, "mechanical_tilt_deg is -91; expected a number from -90 to 90 deg"),
        ({"load": "2"}, "load is 2; expected a number from 0 to 1"),
        ({"load": "-0.1"}, "load is -0.1; expected a number from 0 to 1"),
        ({"power_dbm": "200"}, "power_dbm is 200; expected a number from -50 to 100 dBm"),
        ({"carrier_mhz": "1.8"}, "carrier_mhz is 1.8; expected a number from 500 to 100000 MHz"),
        ({"carrier_mhz": "200000"}, "carrier_mhz is 200000; expected a number from 500 to 100000 MHz"),
        ({"bandwidth_mhz": "7"}, "bandwidth_mhz is 7; expected one of 1.4, 3, 5, 10, 15, 20"),
        ({"bandwidth_mhz": "40"}, "bandwidth_mhz is 40; expected a number from 1.4 to 20 MHz"),
        ({"sector_id": "1"}, "site_id 'A' with sector_id '1' is there already, in line 2"),
        ({"latitude": "-8.4", "longitude": "51.9"}, "latitude -8.4, longitude 51.9 lies"),
        ({"latitude": "north"}, "latitude is 'north'"),
        ({"latitude": "89.5"}, "latitude is 89.5; expected a number from -89 to 89 deg"),
    ],
    ids=lambda value: value[:60] if isinstance(value, str) else "",
)
def test_a_wrong_value_is_named_with_file_line_and_column(tmp_path: Path, change: dict[str, str], message: str) -> None:
    (tmp_path / "broken.msi").write_text("GAIN 17 dBi\nHORIZONTAL 360\n0 zero\n")
    write_antenna(AntennaFile({"ELECTRICAL_TILT": "40"}, 15.0, None, 40.0, np.zeros(360), np.zeros(360)), tmp_path / "flat.msi")
    rows = [ROW, ROW | {"sector_id": "2"} | change, *(ROW | {"sector_id": str(i)} for i in range(3, 8))]
    path = write(tmp_path / "sites.csv", rows)
    with pytest.raises(InputError) as caught:
        read_sites(path)
    assert str(caught.value).startswith(f"{path}, line 3: {message}")
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("value", ["inf", "-3e7", "nan"])
def test_a_place_in_metres_is_finite_and_on_earth(tmp_path: Path, value: str) -> None:
    row = {name: text for name, text in ROW.items() if not name.endswith("itude")} | {"x_m": "0", "y_m": value}
    with pytest.raises(InputError, match=r"sites\.csv, line 2: y_m is "):
        read_sites(write(tmp_path / "sites.csv", [row]))


def test_a_slash_in_a_name_makes_no_two_sectors_one(tmp_path: Path) -> None:
    ids = [("a/b", "c"), ("a", "b/c"), ("a%2Fb", "c"), ("a/b", "d")]
    rows = [ROW | {"site_id": site, "sector_id": sector} for site, sector in ids]
    found = read_sites(write(tmp_path / "sites.csv", rows))
    assert found.names == ("a%2Fb/c", "a/b/c", "a%252Fb/c", "a%2Fb/d")
    assert found.deployment.site.tolist() == [0, 1, 2, 0]
    write_sites(found.deployment, tmp_path / "again.csv", found.names, found.anchor)
    with (tmp_path / "again.csv").open(newline="") as file:
        assert [(line["site_id"], line["sector_id"]) for line in csv.DictReader(file)] == ids
    assert read_sites(tmp_path / "again.csv").names == found.names
    with pytest.raises(InputError, match=r"line 6: site_id 'a/b' with sector_id 'c' is there already, in line 2"):
        read_sites(write(tmp_path / "sites.csv", [*rows, rows[0]]))


def test_sites_on_both_sides_of_the_antimeridian(tmp_path: Path) -> None:
    rows = [ROW | {"site_id": "W", "longitude": "179.99"}, ROW | {"site_id": "E", "longitude": "-179.97"}]
    found = read_sites(write(tmp_path / "sites.csv", rows))
    assert found.anchor is not None
    assert found.anchor.longitude_deg == pytest.approx(-179.99)
    assert np.ptp(found.deployment.x_m) == pytest.approx(0.04 * 68_800, rel=0.01)


def patterns(*gains_dbi: float) -> Deployment:
    """A sector for each gain, all with the same measured cuts."""
    antennas = [PatternAntenna(gain_dbi, np.zeros(360), np.zeros(360)) for gain_dbi in gains_dbi]
    return hexagonal_deployment(rings=0, boresights_deg=np.arange(len(gains_dbi)).tolist(), antenna=antennas)


def peaks_dbi(path: Path) -> list[float]:
    return [antenna.peak_gain_dbi for antenna in read_sites(path).deployment.antenna if isinstance(antenna, PatternAntenna)]


def test_no_antenna_file_of_another_content_is_overwritten(tmp_path: Path) -> None:
    mine = tmp_path / "sites-antenna-1.msi"
    mine.write_text("my own measurements\n")
    (tmp_path / "sites-antenna-3.msi").mkdir()
    write_sites(patterns(11.0, 12.0, 11.0), tmp_path / "sites.csv")
    assert mine.read_text() == "my own measurements\n"
    assert peaks_dbi(tmp_path / "sites.csv") == [11.0, 12.0, 11.0]
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"sites.csv", *(f"sites-antenna-{number}.msi" for number in (1, 2, 3, 4))}
    # Written again, the same antennas need no further files; others do.
    write_sites(patterns(12.0, 11.0), tmp_path / "sites.csv")
    assert {path.name for path in tmp_path.iterdir()} == names
    assert peaks_dbi(tmp_path / "sites.csv") == [12.0, 11.0]
    write_sites(patterns(13.0), tmp_path / "sites.csv")
    assert {path.name for path in tmp_path.iterdir()} == {*names, "sites-antenna-5.msi"}


def test_a_list_that_cannot_be_written_leaves_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(InputError, match="is a folder; expected a file"):
        write_sites(patterns(11.0), tmp_path)
    with pytest.raises(RangeError, match="power is 120 dBm"):
        write_sites(hexagonal_deployment(power_dbm=120.0), tmp_path / "sites.csv")
    monkeypatch.setattr(csv.DictWriter, "writerows", disk_full)
    with pytest.raises(OSError, match="No space left"):
        write_sites(patterns(11.0, 12.0), tmp_path / "sites.csv")
    assert list(tmp_path.iterdir()) == []


def disk_full(*arguments: object) -> None:
    raise OSError(28, "No space left on device")


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    without = {name: value for name, value in ROW.items() if name != "azimuth_deg"}
    with pytest.raises(InputError, match=r"sites\.csv, line 1: no column 'azimuth_deg'; found 12 column"):
        read_sites(write(tmp_path / "sites.csv", [without]))
    with pytest.raises(InputError, match="neither latitude, longitude and x_m, y_m"):
        read_sites(write(tmp_path / "sites.csv", [{k: v for k, v in ROW.items() if not k.endswith("itude")}]))
    with pytest.raises(InputError, match="both latitude, longitude and x_m, y_m"):
        read_sites(write(tmp_path / "sites.csv", [ROW | {"x_m": "0", "y_m": "0"}]))


CELLS = [
    "LTE,272,5,40,{cell},0,-8.40,51.90,1000,10,1,1,1,0",
    "LTE,272,5,40,{other},0,-8.38,51.90,1000,30,1,1,1,0",
    "GSM,272,5,40,7,0,-8.40,51.90,1000,10,1,1,1,0",
    "LTE,272,1,40,99999,0,-8.41,51.91,1000,10,1,1,1,0",
    "LTE,272,5,40,{far},0,-8.35,51.92,1000,,1,1,1,0",
]

CELL = CELLS[0].format(cell=500 * 256) + "\n"
HEADER = "radio,mcc,net,area,cell,unit,lon,lat,range,samples,changeable,created,updated,averageSignal"


def test_opencellid(tmp_path: Path) -> None:
    lines = [line.format(cell=500 * 256 + 1, other=500 * 256 + 2, far=700 * 256) for line in CELLS]
    path = tmp_path / "272.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"cells of 2 operators, 272-5 \(2 sites\), 272-1 \(1 sites\); choose one: `operator`"):
        read_opencellid(path)
    with pytest.raises(InputError, match="no cells of operator 9-9"):
        read_opencellid(path, "9-9")
    found = read_opencellid(path, "272-5", AssumedSectors(azimuths_deg=(0.0, 180.0)))
    assert found.names == ("500/0", "500/1", "700/0", "700/1")
    assert found.deployment.boresight_deg.tolist() == [90.0, 270.0] * 2
    # 10 samples at -8.40 and 30 at -8.38: the site is at -8.385.
    x_m, _ = to_local(51.90, -8.385, found.anchor)
    assert found.deployment.x_m[0] == pytest.approx(float(x_m))
    assert found.account[0] == "272.csv: 3 LTE cells of operator 272-5 at 2 sites, 1 cells of radio GSM left out"
    assert found.account[1].startswith("assumed for every site: sectors at 0, 180 deg, 25 m")
    path.write_text(HEADER + "\n" + "\n".join(lines))
    assert read_opencellid(path, "272-5").deployment.n_sectors == 6
    path.write_text(lines[2])
    with pytest.raises(InputError, match="no LTE cells"):
        read_opencellid(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "272.csv: the file is empty; expected a list of cells from OpenCelliD"),
        (CELL.encode() + b"LTE,272,5,40,\xff\n", "272.csv, line 2: not readable as text"),
        (CELL.encode() + b"LTE,272,5\n", "272.csv, line 2: 3 field(s); expected 14"),
        (CELL.replace("51.90", "91").encode(), "272.csv, line 1: lat is 91; expected a number from -89 to 89 deg"),
        (CELL.replace(",10,", ",inf,").encode(), "272.csv, line 1: samples is inf; expected a number"),
        (b"radio,mcc,net,area,cell,unit,lon,range\n" + CELL.encode(), "272.csv, line 1: no column 'lat'"),
        (HEADER.replace("unit", "pci").encode() + b"\n" + CELL.encode(), "272.csv, line 1: a header with other columns"),
    ],
)
def test_a_wrong_opencellid_file_is_named_with_its_line(tmp_path: Path, content: bytes, message: str) -> None:
    (tmp_path / "272.csv").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_opencellid(tmp_path / "272.csv")
    assert message in str(caught.value)


def test_assumed_bearings_are_compass_bearings() -> None:
    for wrong_deg in (400.0, -1.0, np.nan):
        with pytest.raises(RangeError, match=r"azimuths_deg is .* expected 0\.\.360 deg"):
            AssumedSectors(azimuths_deg=(0.0, wrong_deg))
    with pytest.raises(InputError, match="azimuths_deg is empty"):
        AssumedSectors(azimuths_deg=())


def test_cells_on_both_sides_of_the_antimeridian(tmp_path: Path) -> None:
    path = tmp_path / "542.csv"
    path.write_text(CELL.replace("-8.40", "179.99") + CELL.replace("-8.40", "-179.97"))
    found = read_opencellid(path)
    assert found.anchor.longitude_deg == pytest.approx(-179.99)
    assert found.deployment.x_m == pytest.approx(0.0, abs=1e-6)


def test_a_note_stands_in_every_line_and_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "272.csv").write_text(CELL)
    found = read_opencellid(tmp_path / "272.csv")
    write_sites(found.deployment, tmp_path / "sites.csv", found.names, found.anchor, found.note)
    with (tmp_path / "sites.csv").open(newline="") as file:
        assert [line["note"] for line in csv.DictReader(file)] == ["assumed: everything but the position"] * 3
    assert read_sites(tmp_path / "sites.csv").names == found.names
    write_sites(found.deployment, tmp_path / "plain.csv", found.names, found.anchor)
    assert "note" not in (tmp_path / "plain.csv").read_text()


def test_a_packed_export_is_unpacked(tmp_path: Path) -> None:
    lines = ["LTE,502,19,21,256001,0,101.77,2.923,1000,50,1,0,0,0", "LTE,502,19,21,512001,0,101.779,2.929,1000,50,1,0,0,0"]
    packed = tmp_path / "502.csv.gz"
    packed.write_bytes(gzip.compress("\n".join(lines).encode()))
    (tmp_path / "502.csv").write_text("\n".join(lines))
    assert read_opencellid(packed).names == read_opencellid(tmp_path / "502.csv").names
    packed.write_bytes(packed.read_bytes()[:40])
    with pytest.raises(InputError, match=r"502\.csv\.gz: cannot be read"):
        read_opencellid(packed)
    packed.write_text("LTE,502")
    with pytest.raises(InputError, match=r"502\.csv\.gz: cannot be read"):
        read_opencellid(packed)


def test_a_site_may_be_called_na(tmp_path: Path) -> None:
    deployment = hexagonal_deployment(rings=0)
    write_sites(deployment, tmp_path / "sites.csv", ["NA/none", "NA/-", "b/c"])
    assert read_sites(tmp_path / "sites.csv").names == ("NA/none", "NA/-", "b/c")
