"""Kinds of logs: how each is recognised, what it drops, where its heights come from."""

import gzip
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import LogOptions, account_of, import_logs, read_log
from cellpilot.maps.geodesy import farthest_from_the_rest
from cellpilot.maps.samples import ELLIPSOID, STATED, TAKE_OFF, Samples
from cellpilot.maps.sources.columns import named_columns
from cellpilot.maps.sources.measured_log import heights_m

NETWORK_SURVEY = (
    "deviceTime,latitude,longitude,altitude,speed,accuracy,missionId,recordNumber,groupNumber,mcc,mnc,tac,eci,earfcn,pci,rsrp,rsrq,ta,"
    "servingCell,lteBandwidth,provider,signalStrength,cqi,slot,snr,deviceSerialNumber,locationAge"
)
GNETTRACK = "Timestamp,Longitude,Latitude,Speed,Operatorname,CellID,NetworkMode,RSRP,RSRQ,SNR,CQI"


def survey_line(
    latitude: str = "51.9",
    longitude: str = "-8.4",
    altitude: str = "120.5",
    accuracy: str = "4.0",
    rsrp: str = "-90.0",
    snr: str = "12.0",
    serving: str = "true",
    age: str = "",
) -> str:
    return (
        f"2026-11-25T10:00:00Z,{latitude},{longitude},{altitude},0.0,{accuracy},m,1,1,272,5,1,1101,1300,20,{rsrp},-11.0,,"
        f"{serving},MHZ_20,B,-90,,0,{snr},x,{age}"
    )


def write(path: Path, lines: Sequence[str]) -> Path:
    path.write_text("\n".join(lines) + "\n")
    return path


def test_network_survey_keeps_what_is_fresh_certain_and_serving(tmp_path: Path) -> None:
    lines = [
        "# CSV Version=0.4.0",
        NETWORK_SURVEY,
        survey_line(),
        survey_line(snr="2147483647"),
        survey_line(snr="", serving="false"),
        survey_line(accuracy="80"),
        survey_line(age="9000"),
        survey_line(age="900", altitude="131.0", snr="-3.5"),
        survey_line(altitude=""),
        survey_line(snr="", rsrp=""),
        "# comment in the middle",
    ]
    table, account = read_log(write(tmp_path / "log.csv", lines))
    np.testing.assert_array_equal(table.sinr_db, [12.0, np.nan, -3.5])
    assert table.altitude_m.tolist() == [120.5, 120.5, 131.0]
    assert set(table.altitude_reference) == {"ellipsoid"}
    assert set(table.cell) == {"1101"}
    assert (account.kind, account.kept, account.rsrp_rows) == ("Network Survey (LTE)", 2, 1)
    assert account.dropped == {
        "notes": 1,
        "of neighbour cells": 1,
        "at positions uncertain by more than 30 m": 1,
        "at positions older than 5 s": 1,
        "without altitude": 1,
        "without SINR or RSRP": 1,
    }
    loose, _ = read_log(tmp_path / "log.csv", LogOptions(max_accuracy_m=100.0, max_age_s=10.0))
    assert len(loose) == 5


def test_altitudes_of_gps_need_the_ground(tmp_path: Path) -> None:
    lines = [NETWORK_SURVEY, *(survey_line(f"51.9{i:03d}", altitude=str(57.0 + 7 * i)) for i in range(6))]
    path = write(tmp_path / "log.csv", lines)
    with pytest.raises(
        InputError, match=r"log\.csv: its altitudes count from the ellipsoid, the lowest is 57\.0 m; .*`ground_altitude"
    ):
        import_logs([path], mask=None)
    dataset = import_logs([path], mask=None, ground_altitude_m=57.0, fill_radius_m=0.0)
    assert dataset["z"].values.tolist() == [0.0, 10.0, 20.0, 30.0, 40.0]  # 0, 7, 14, 21, 28, 35 m
    assert dataset["count"].values.sum(axis=(1, 2)).tolist() == [1, 2, 1, 1, 1]
    one = import_logs([path], mask=None, altitude_m=40.0)
    assert one["z"].values.tolist() == [40.0]


def test_a_log_with_own_altitudes_may_be_split_anywhere(tmp_path: Path) -> None:
    lines = [survey_line(f"51.9{i:03d}", altitude=str(60.0 + 3 * i), snr=str(i)) for i in range(8)]
    whole = import_logs([write(tmp_path / "all.csv", [NETWORK_SURVEY, *lines])], mask=None, ground_altitude_m=57.0)
    parts = [write(tmp_path / f"{i}.csv", [NETWORK_SURVEY, *reversed(lines[i : i + 2])]) for i in (4, 0, 6, 2)]
    split = import_logs(parts, mask=None, ground_altitude_m=57.0)
    assert whole.drop_attrs().identical(split.drop_attrs())


def test_gnettrack_with_dashes_and_its_height(tmp_path: Path) -> None:
    lines = [
        GNETTRACK,
        "2019.12.14_10.16.30,-8.388186,51.935604,0,B,12,5G,-99,-15,6.0,12",
        "2019.12.14_10.16.31,-8.38847,51.935739,1,B,12,5G,-99,-15,-,12",
        "2019.12.14_10.16.32,-8.38847,51.935739,1,B,12,5G,-,-,-,-",
        "2019.12.14_10.16.33,-8.38850,51.935750,1,B,13,LTE,-101,-14,-2.0,12",
    ]
    path = write(tmp_path / "drive.csv", lines)
    with pytest.raises(InputError, match="the log has no height: give `altitude_m` METRES"):
        read_log(path)
    table, account = read_log(path, LogOptions(altitude_m=1.5))
    np.testing.assert_array_equal(table.sinr_db, [6.0, np.nan, -2.0])
    assert table.cell.tolist() == ["12", "12", "13"]
    assert account.dropped == {"without SINR or RSRP": 1}
    text = "\n".join(line.replace(",", "\t") for line in lines)
    tabs, _ = read_log(write(tmp_path / "drive.txt", [text]), LogOptions(altitude_m=1.5))
    np.testing.assert_array_equal(tabs.sinr_db, table.sinr_db)


def test_named_columns(tmp_path: Path) -> None:
    lines = ["when;north;east;h_ft;quality", "1;47.1;8.1;100;5.5", "2;47.2;8.1;200;-", "3;47.2;8.2;300;-1"]
    path = write(tmp_path / "mine.csv", lines)
    chosen = named_columns("lat=north,lon=east,alt=h_ft,sinr=quality,time=when", altitude_reference="take-off")
    table, account = read_log(path, LogOptions(format=chosen))
    assert table.sinr_db.tolist() == [5.5, -1.0]
    np.testing.assert_allclose(table.altitude_m, [30.48, 91.44])
    assert account.kind == "named columns"
    with pytest.raises(InputError, match=r"mine\.csv, line 1: no column 'SINR'; found 5 column"):
        read_log(path, LogOptions(format=named_columns("lat=north,lon=east,sinr=SINR"), altitude_m=3.0))


@pytest.mark.parametrize(
    ("text", "unit", "reference", "message"),
    [
        (
            "lat=a,lon=b,sinr=c,alt=altitude",
            None,
            "take-off",
            "nothing says whether the altitude in 'altitude' is in metres or feet",
        ),
        ("lat=a,lon=b,sinr=c,alt=format", None, "take-off", "metres or feet"),
        ("lat=a,lon=b,sinr=c,alt=alt_m", None, None, "nothing says what the altitude in 'alt_m' counts from"),
        ("lat=a,lon=b", None, None, "names no column for sinr"),
        ("lat=a,lon=b,sinr=c,lat=d", None, None, "'lat=d'; expected NAME=COLUMN"),
        ("lat=a,lon=b,sinr", None, None, "'sinr'; expected NAME=COLUMN"),
        ("lat=a,lon=b,sinr=c,height=d", None, None, "'height=d'; expected NAME=COLUMN"),
    ],
)
def test_what_columns_do_not_say_is_asked_for(text: str, unit: str | None, reference: str | None, message: str) -> None:
    with pytest.raises(InputError, match=message):
        named_columns(text, unit, reference)


def test_exchanged_coordinates_are_named(tmp_path: Path) -> None:
    lines = [GNETTRACK] + [f"t,{8.4 + i / 1e4},51.9,0,B,12,5G,-99,-15,6.0,12" for i in range(9)]
    lines[5] = "t,51.9,8.4,0,B,12,5G,-99,-15,6.0,12"
    path = write(tmp_path / "log.csv", lines)
    with pytest.raises(InputError, match=r"log\.csv, line 6: latitude 8\.4, longitude 51\.9 lies 6,\d* km from the middle"):
        read_log(path, LogOptions(altitude_m=1.5))


def test_the_antimeridian_is_no_distance() -> None:
    longitude = np.array([179.99, -179.99, 179.98, -179.98, -179.97])
    _, distance_km = farthest_from_the_rest(np.full(5, -17.0), longitude)
    assert distance_km < 5


def test_the_account_of_a_map_of_version_0_1_can_be_read(tmp_path: Path) -> None:
    path = write(tmp_path / "log.csv", [NETWORK_SURVEY, survey_line(), survey_line("51.901")])
    dataset = import_logs([path], mask=None, altitude_m=40.0)
    old = dataset.attrs["import_account"].replace('"altitude_m": [40.0, 40.0]', '"altitude_m": 40.0')
    dataset.attrs["import_account"] = old.replace('"kind": "Network Survey (LTE)", ', "")
    assert account_of(dataset).logs[0].altitude_m == (40.0, 40.0)


def test_the_days_of_a_log_that_dates_its_samples(tmp_path: Path) -> None:
    lines = [NETWORK_SURVEY, *(survey_line(latitude=f"51.9{i:03d}") for i in range(4))]
    earlier = [lines[0], *(line.replace("2026-11-25", "2026-03-01") for line in lines[1:])]
    one, two = write(tmp_path / "one.csv", lines), write(tmp_path / "two.csv", earlier)
    assert read_log(one)[1].days == ("2026-11-25", "2026-11-25")
    both = account_of(import_logs([one, two], altitude_m=30.0))
    assert both.days == ("2026-03-01", "2026-11-25")
    undated = write(tmp_path / "three.csv", [lines[0], lines[1].replace("2026-11-25", "today"), *lines[2:]])
    assert read_log(undated)[1].days is None
    impossible = write(tmp_path / "four.csv", [lines[0], *(line.replace("11-25", "02-30") for line in lines[1:])])
    assert read_log(impossible)[1].days is None
    assert account_of(import_logs([one, undated], altitude_m=30.0)).days is None


def test_a_packed_log_and_a_column_that_is_there_twice(tmp_path: Path) -> None:
    lines = ["Time,Latitude,Longitude,RS SNR", *(f"10:00:0{i},51.9,-8.40{i},{i}" for i in range(4))]
    (tmp_path / "field_30m.csv.gz").write_bytes(gzip.compress("\n".join(lines).encode()))
    samples, _ = read_log(tmp_path / "field_30m.csv.gz")
    assert samples.altitude_m.tolist() == [30.0] * 4
    damaged = bytearray((tmp_path / "field_30m.csv.gz").read_bytes())
    damaged[20] ^= 255
    (tmp_path / "field_30m.csv.gz").write_bytes(damaged)
    with pytest.raises(InputError, match=r"field_30m\.csv\.gz"):
        read_log(tmp_path / "field_30m.csv.gz")
    twice = write(tmp_path / "30m.csv", [line + ",1" for line in lines])
    twice.write_text(twice.read_text().replace("SNR,1", "SNR,RS SNR"))
    with pytest.raises(InputError, match="two columns 'RS SNR'"):
        read_log(twice)


def test_the_ground_counts_for_altitudes_above_the_ellipsoid_alone() -> None:
    n = 3
    text, number = np.full(n, ""), np.zeros(n)
    references = np.array([STATED, TAKE_OFF, ELLIPSOID])
    altitude_m = np.array([32.5, 47.0, 158.0])
    samples = Samples(text, number, number, altitude_m, references, number, number, number, text, text)
    assert heights_m(samples, 10.0, 100.0).tolist() == [32.5, 50.0, 60.0]
