"""Reading one drive-test log: what is kept, what is dropped and counted, what is refused and how."""

import re
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from maps_logs import HEADER, WriteLog

from cellpilot.errors import InputError
from cellpilot.maps import LogOptions, read_log

LINES = (
    "10:00:00.0,,,,7.0",  # no position yet
    "10:00:01.0,0.0100,0.0100,-81.0,",
    "10:00:01.0,0.0100,0.0100,,4.5",
    "10:00:01.0,0.0100,0.0100,,n/a",
    "10:00:02.0,0.0101,0.0100,, -2.5 ",
    "10:00:03.0,0.0101,,,3.0",  # half a position
    "10:00:03.0,0,0.0,,3.0",  # no fix
    "10:00:04.0,0.0102,0.0100,n/a,",
    "",
    "Exported Measurements",
    r"C:\somewhere\log.nmfs",
)


def test_every_line_is_kept_or_counted(write_log: WriteLog) -> None:
    table, account = read_log(write_log(LINES))
    np.testing.assert_array_equal(table.sinr_db, [np.nan, 4.5, -2.5])
    np.testing.assert_array_equal(table.rsrp_dbm, [-81.0, np.nan, np.nan])
    assert table.latitude_deg.tolist() == [0.01, 0.01, 0.0101]
    assert table.longitude_deg.tolist() == [0.01, 0.01, 0.01]
    assert table.altitude_m.tolist() == [30.0, 30.0, 30.0]
    assert table.time.tolist() == ["10:00:01.0", "10:00:01.0", "10:00:02.0"]
    assert set(table.altitude_reference) == {"stated"}
    assert set(table.source) == {"30m.csv"}
    assert account.dropped == {
        "without position": 2,
        "at position 0, 0 (no fix)": 1,
        "without SINR or RSRP": 2,
        "notes": 2,
    }
    assert account.rows == account.kept + account.rsrp_rows + sum(account.dropped.values()) == 10


def test_byte_order_mark_windows_line_ends_and_notes_anywhere(write_log: WriteLog) -> None:
    plain, plain_account = read_log(write_log(LINES))
    moved = [LINES[-1], *LINES[:-1]]
    marked, account = read_log(write_log([line + "\r" for line in moved], "windows_30m.csv", HEADER + "\r", b"\xef\xbb\xbf"))
    np.testing.assert_array_equal(marked.sinr_db, plain.sinr_db)
    assert account.dropped == plain_account.dropped


def test_a_line_with_both_keeps_both_and_the_rsrp_column_is_optional(write_log: WriteLog) -> None:
    both, account = read_log(write_log(["t,0.01,0.01,-80,3", "t,0.01,0.01,-81,4"]))
    assert (both.sinr_db.tolist(), both.rsrp_dbm.tolist(), account.rsrp_rows) == ([3, 4], [-80, -81], 0)
    without, _ = read_log(write_log(["0.01,0.01,3", "0.01,0.01,4"], header="Longitude,Latitude,RS SNR"))
    assert np.isnan(without.rsrp_dbm).all()


@pytest.mark.parametrize(("name", "height_m"), [("30m.csv", 30), ("field_30m.csv", 30), ("a_b_12.5M.csv", 12.5)])
def test_height_from_the_file_name(write_log: WriteLog, name: str, height_m: float) -> None:
    assert read_log(write_log(LINES, name))[0].altitude_m[0] == height_m
    assert read_log(write_log(LINES, name), LogOptions(altitude_m=77.0))[0].altitude_m[0] == 77


@pytest.mark.parametrize("name", ["log.csv", "30.csv", "30m_field.csv", "room30m.csv"])
def test_no_height_in_the_file_name(write_log: WriteLog, name: str) -> None:
    with pytest.raises(InputError, match=r"no height; the file name gives none.* give `altitude_m`"):
        read_log(write_log(LINES, name))


@pytest.mark.parametrize("altitude_m", [-1.0, float("nan")])
def test_impossible_altitude(write_log: WriteLog, altitude_m: float) -> None:
    with pytest.raises(InputError, match="altitude given is"):
        read_log(write_log(LINES), LogOptions(altitude_m=altitude_m))


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("t,101.77,0.01,,3", "line 3: Latitude is 101.77; expected a number from -90 to 90 deg"),
        ("t,0.01,-180.5,,3", "line 3: Longitude is -180.5; expected a number from -180 to 180 deg"),
        ("t,101.77,0.01,-80,", "line 3: Latitude is 101.77"),
        ("t,0.01,0.01,,three", "line 3: RS SNR is 'three'; expected a number"),
        ("t,0.01,0.01,,9999", "line 3: RS SNR is 9999; expected a number from -50 to 70 dB"),
        ("t,0.01,0.01,,inf", "line 3: RS SNR is inf"),
        ("t,0.01,0.01,,1_0", "line 3: RS SNR is '1_0'"),
        ('t,0.01,0.01,,"2,5"', "line 3: RS SNR is '2,5'"),
        ("t,0.01,0.01,x,", "line 3: RSRP (LTE pcell) is 'x'"),
        ("t,0.01,0.01,,3,4", "line 3: 6 field(s); expected 5"),
        ("t,0.0", "line 3: 2 field(s); expected 5"),
    ],
)
def test_a_broken_line_is_named(write_log: WriteLog, line: str, message: str) -> None:
    path = write_log(["t,0.01,0.01,,3", line, "t,0.01,0.01,,5"])
    with pytest.raises(InputError, match=re.escape(f"{path}, {message}")) as caught:
        read_log(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "the file is empty"),
        (b"\xef\xbb\xbf\n\n", "the file is empty"),
        (b"a;b;c\n1;2;3\n", "a log of unknown kind with 3 column(s): 'a', 'b', 'c'; known are"),
        (b"Time,Latitude,Longitude,RSRP (LTE pcell)\n", "a log of unknown kind"),
        (f"{HEADER}\n".encode(), "0 usable value"),
        (f"{HEADER}\nt,0.01,0.01,-80,\nt,0.01,0.01,,n/a\n".encode(), "0 usable value(s) of 'RS SNR' in 2 line(s)"),
        (f"{HEADER}\nt,0.01,0.01,,3\n".encode(), "1 usable value(s) of 'RS SNR' in 1 line(s); expected at least 2"),
        (HEADER.encode("utf-16"), "line 1: not readable as text"),
        (f"{HEADER}\nt,0.01,0.01,,3\n".encode() + b"\xff" * 9, "not readable as text"),
        (f'{HEADER}\n"'.encode() + b"x" * 200_000, "not readable as text"),
    ],
)
def test_a_useless_file_is_named(tmp_path: Path, content: bytes, message: str) -> None:
    path = tmp_path / "30m.csv"
    path.write_bytes(content)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_log(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_and_a_folder(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"30m\.csv: no such file"):
        read_log(tmp_path / "30m.csv")
    with pytest.raises(InputError, match="not a file"):
        read_log(tmp_path, LogOptions(altitude_m=30.0))


def test_shipped_logs_are_what_the_script_writes(tmp_path: Path) -> None:
    from make_synthetic_logs import main

    main(tmp_path)
    for path in tmp_path.iterdir():
        shipped = files("cellpilot").joinpath("data", path.name).read_text(encoding="utf-8")
        assert shipped == path.read_text(encoding="utf-8")
        assert len(shipped) <= 60_000
