"""Site lists and OpenCelliD files: what is read, that nothing is lost on the way, what is refused."""

import csv
import re
from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, AssumedSectors, read_opencellid, read_sites, simulate_map, to_local, write_sites
from cellpilot.radio import (
    AntennaFile,
    ColumnAntenna,
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
        ({"azimuth_deg": ""}, "line 3: azimuth_deg is empty; expected a number from 0 to 360 deg"),
        ({"azimuth_deg": "361"}, "line 3: azimuth_deg is 361; expected a number from 0 to 360 deg"),
        ({"height_m": "1000"}, "line 3: height_m is 1000; expected a number from 1.5 to 300 m"),
        ({"antenna": "colum(8)"}, "line 3: antenna is 'colum(8)'; expected column("),
        ({"antenna": ""}, "line 3: antenna is empty"),
        ({"electrical_tilt_deg": ""}, "line 3: electrical_tilt_deg is empty; expected the downtilt of the column"),
        ({"load": "2"}, "line 3: load is 2; expected a number from 0 to 1"),
        ({"bandwidth_mhz": "7"}, "bandwidth is 7 MHz; expected one of"),
        ({"sector_id": "1"}, "line 3: site_id 'A' with sector_id '1' is there already, in line 2"),
        ({"latitude": "-8.4", "longitude": "51.9"}, "line 3: latitude -8.4, longitude 51.9 lies"),
        ({"latitude": "north"}, "line 3: latitude is 'north'"),
    ],
)
def test_a_wrong_line_is_named(tmp_path: Path, change: dict[str, str], message: str) -> None:
    rows = [ROW, ROW | {"sector_id": "2"} | change, *(ROW | {"sector_id": str(i)} for i in range(3, 8))]
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_sites(write(tmp_path / "sites.csv", rows))
    assert "\n" not in str(caught.value)


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


def test_opencellid(tmp_path: Path) -> None:
    lines = [line.format(cell=500 * 256 + 1, other=500 * 256 + 2, far=700 * 256) for line in CELLS]
    path = tmp_path / "272.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(InputError, match=r"cells of 2 operators, 272-5 \(2 sites\), 272-1 \(1 sites\); choose one: --operator"):
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
    path.write_text(
        "radio,mcc,net,area,cell,unit,lon,lat,range,samples,changeable,created,updated,averageSignal\n" + "\n".join(lines)
    )
    assert read_opencellid(path, "272-5").deployment.n_sectors == 6
    path.write_text(lines[2])
    with pytest.raises(InputError, match="no LTE cells"):
        read_opencellid(path)
