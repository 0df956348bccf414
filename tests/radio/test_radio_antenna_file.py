"""Antenna files: what is read, round trips, the pattern in space, and what is refused."""

import re
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError, RangeError
from cellpilot.radio import AntennaFile, PatternAntenna, read_antenna, write_antenna

SHARED = Path(__file__).parents[3] / "shared" / "data" / "antennas"
CUT_DB = np.round(30 * np.abs(np.sin(np.radians(np.arange(360)) / 2)), 2)
HEADER = ["NAME test", "FREQUENCY 1845", "GAIN 16.95 dBd", "TILT ELECTRICAL"]


def lines(header: list[str] = HEADER, vertical_peak_deg: int = 5) -> list[str]:
    vertical_db = np.roll(CUT_DB, vertical_peak_deg)
    return [
        *header,
        "HORIZONTAL 360",
        *(f"{i} {a:g}" for i, a in enumerate(CUT_DB)),
        "VERTICAL\t360",
        *(f"{i:.2f}\t{a:.2f}" for i, a in enumerate(vertical_db)),
    ]


def write(path: Path, text: list[str]) -> Path:
    path.write_text("\n".join(text) + "\n")
    return path


def test_header_and_cuts(tmp_path: Path) -> None:
    found = read_antenna(write(tmp_path / "a.msi", lines()))
    assert found.gain_dbi == pytest.approx(19.10)
    assert found.frequency_hz == 1845e6
    assert found.electrical_tilt_deg == 5  # not stated: where the vertical cut has its peak
    assert found.header["NAME"] == "test"
    np.testing.assert_array_equal(found.horizontal_db, CUT_DB)
    np.testing.assert_array_equal(found.vertical_db, np.roll(CUT_DB, 5))


@pytest.mark.parametrize(
    ("gain", "dbi"), [("16.95 dBd", 19.10), ("16.95", 19.10), ("17 dBi", 17.0), ("17dBi", 17.0), ("-2.15 DBD", 0.0)]
)
def test_gain_in_dbd_unless_it_says_dbi(tmp_path: Path, gain: str, dbi: float) -> None:
    assert read_antenna(write(tmp_path / "a.pln", lines(["NAME x", f"GAIN {gain}"]))).gain_dbi == pytest.approx(dbi)


@pytest.mark.parametrize(
    ("tilt", "deg"), [("ELECTRICAL_TILT 3", 3.0), ("TILT 6", 6.0), ("TILT ELECTRICAL 6.5", 6.5), ("TILT MECHANICAL", 5.0)]
)
def test_stated_tilt_or_that_of_the_peak(tmp_path: Path, tilt: str, deg: float) -> None:
    assert read_antenna(write(tmp_path / "a.msi", lines([*HEADER[:3], tilt]))).electrical_tilt_deg == deg


def test_round_trip(tmp_path: Path) -> None:
    found = read_antenna(write(tmp_path / "a.msi", lines()))
    write_antenna(found, tmp_path / "b.msi")
    again = read_antenna(tmp_path / "b.msi")
    assert again.gain_dbi == found.gain_dbi
    assert again.electrical_tilt_deg == found.electrical_tilt_deg
    np.testing.assert_array_equal(again.horizontal_db, found.horizontal_db)
    np.testing.assert_array_equal(again.vertical_db, found.vertical_db)


@pytest.mark.shared
@pytest.mark.parametrize("name", ["AMB4520R8v06_05T.msi", "B800A065-18-4E.pln", "SV460-SF2SNM_0960_00T.msi"])
def test_vendor_files_peak_at_their_gain_and_survive_a_round_trip(tmp_path: Path, name: str) -> None:
    found = read_antenna(SHARED / name)
    antenna = found.antenna()
    boresight_deg = -float(found.horizontal_db.argmin())
    assert antenna.gain_dbi(boresight_deg, 90 + antenna.downtilt_deg) == pytest.approx(found.gain_dbi, abs=1e-9)
    everywhere = antenna.gain_dbi(np.arange(-180, 180)[:, None], np.arange(181)[None])
    assert everywhere.max() == pytest.approx(found.gain_dbi, abs=1e-9)
    write_antenna(found, tmp_path / name)
    np.testing.assert_array_equal(read_antenna(tmp_path / name).vertical_db, found.vertical_db)


def test_lines_that_come_again_are_all_kept(tmp_path: Path) -> None:
    header = ["NAME first", "COMMENT one", "GAIN 17 dBi", "COMMENT", "comment two", "NAME second", "TILT 3", "TILT 8"]
    found = read_antenna(write(tmp_path / "a.msi", [*lines(header), "COMMENT below the cuts"]))
    assert found.header["COMMENT"] == "one\n\ntwo\nbelow the cuts"
    # Of what can be one thing only, the first line says which.
    assert (found.antenna().name, found.gain_dbi, found.electrical_tilt_deg) == ("first", 17.0, 3.0)
    write_antenna(found, tmp_path / "b.msi")
    again = read_antenna(tmp_path / "b.msi")
    assert again.header == found.header | {"GAIN": "17.0 dBi"}
    assert again.antenna().name == "first"


def test_directions() -> None:
    horizontal_db, vertical_db = np.zeros(360), np.zeros(360)
    horizontal_db[90], vertical_db[10] = 7.0, 3.0  # 90 degrees clockwise, 10 degrees below the horizon
    antenna = PatternAntenna(20.0, horizontal_db, vertical_db)
    assert antenna.gain_dbi(-90.0, 90.0) == pytest.approx(13.0)
    assert antenna.gain_dbi(270.0, 90.0) == pytest.approx(13.0)
    assert antenna.gain_dbi(90.0, 90.0) == pytest.approx(20.0)
    assert antenna.gain_dbi(0.0, 100.0) == pytest.approx(17.0)
    assert antenna.gain_dbi(0.0, 80.0) == pytest.approx(20.0)
    assert antenna.gain_dbi(-89.5, 90.0) == pytest.approx(16.5)  # half a degree beside it


def test_both_tilts() -> None:
    vertical_db = np.roll(CUT_DB, 5)
    plain = PatternAntenna(20.0, np.zeros(360), vertical_db)
    electrical = PatternAntenna(20.0, np.zeros(360), vertical_db, electrical_tilt_deg=4.0)
    mechanical = PatternAntenna(20.0, np.zeros(360), vertical_db, mechanical_tilt_deg=4.0)
    assert (plain.downtilt_deg, electrical.downtilt_deg) == (5.0, 9.0)
    for azimuth_deg in (0.0, 90.0, 180.0):
        assert electrical.gain_dbi(azimuth_deg, 99.0) == pytest.approx(20.0)
    assert mechanical.gain_dbi(0.0, 99.0) == pytest.approx(20.0)
    assert mechanical.gain_dbi(180.0, 91.0) == pytest.approx(20.0)  # lowered in front, raised behind


def test_a_file_at_another_tilt(tmp_path: Path) -> None:
    found = read_antenna(write(tmp_path / "a.msi", lines()))
    assert found.antenna(2.0).downtilt_deg == 2.0
    assert found.antenna().downtilt_deg == 5.0


@settings(max_examples=50, deadline=None)
@given(st.floats(-720, 720), st.floats(0, 180), st.floats(-90, 90), st.floats(-90, 90))
def test_gain_is_never_above_the_peak(azimuth: float, zenith: float, electrical: float, mechanical: float) -> None:
    antenna = PatternAntenna(15.0, CUT_DB + 0.5, np.roll(CUT_DB, 3), electrical, mechanical)
    gain = antenna.gain_dbi(azimuth, zenith)
    assert 15.0 - 60.001 <= gain <= 15.0 + 1e-9


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[:-1], "line 726: the end of the file as line 360 of the cut VERTICAL; expected 360 lines"),
        (lambda text: [*text[:364], *text[365:]], "line 365: 'VERTICAL\\t360' as line 360 of the cut HORIZONTAL"),
        (lambda text: [*text, "360 1.0"], "line 727: more than 360 lines in the cut VERTICAL"),
        (lambda text: [*text[:10], "99 1.0", *text[11:]], "line 11: angle 99 in the cut HORIZONTAL; expected 5"),
        (
            lambda text: [*text[:10], "5 -1.0", *text[11:]],
            "line 11: attenuation -1.0 dB in the cut HORIZONTAL; expected 0 to 1000 dB",
        ),
        (lambda text: [*text[:10], "5 low", *text[11:]], "line 11: '5 low' as line 6"),
        (lambda text: text[:365], "no line VERTICAL 360"),
        (lambda text: ["NAME x", *text[4:]], "GAIN is ''; expected a number in dBd"),
        (lambda text: ["GAIN 17 dB", *text[4:]], "GAIN is '17 dB'"),
    ],
)
def test_what_is_refused(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = write(tmp_path / "a.msi", change(lines()))
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        read_antenna(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_impossible_patterns() -> None:
    with pytest.raises(InputError, match=r"no such file|cannot be read"):
        read_antenna("nowhere.msi")
    with pytest.raises(InputError, match=r"horizontal cut has shape \(359,\)"):
        PatternAntenna(1.0, np.zeros(359), np.zeros(360))
    with pytest.raises(RangeError, match="mechanical tilt"):
        PatternAntenna(1.0, np.zeros(360), np.zeros(360), mechanical_tilt_deg=100.0)


def test_an_antenna_file_made_by_hand(tmp_path: Path) -> None:
    made = AntennaFile({"NAME": "x", "ELECTRICAL_TILT": "0"}, 12.3456789, None, 0.0, CUT_DB, CUT_DB)
    write_antenna(made, tmp_path / "x.msi")
    assert read_antenna(tmp_path / "x.msi").gain_dbi == made.gain_dbi


@pytest.mark.parametrize(
    "line",
    [
        *("ELECTRICAL_TILT 3,5", "ELECTRICAL_TILT 1e9", "ELECTRICAL_TILT -91", "TILT 91", "TILT 3 4", "TILT 6.5x"),
        *("FREQUENCY 1845,5", "FREQUENCY 1e9x", "FREQUENCY 0", "FREQUENCY 1710 2170"),
    ],
)
def test_a_header_that_is_not_all_a_number_is_refused(tmp_path: Path, line: str) -> None:
    word = line.split()[0]
    header = [text for text in HEADER if text.split()[0] not in (word, "TILT")] + [line]
    cut = [f"{degree} 0" for degree in range(360)]
    path = tmp_path / "a.msi"
    path.write_text("\n".join([*header, "HORIZONTAL 360", *cut, "VERTICAL 360", *cut]))
    with pytest.raises(InputError, match=rf"a\.msi: {word} is .*; expected one number"):
        read_antenna(path)
    path.write_text("\n".join([*HEADER, "HORIZONTAL 360", *cut, "VERTICAL 360", *cut, "VERTICAL 360", *cut]))
    with pytest.raises(InputError, match="a second cut VERTICAL"):
        read_antenna(path)
