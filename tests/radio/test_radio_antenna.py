"""Antenna gains: reference vectors, an independent sum over the elements, tilt."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot.errors import InputError, RangeError
from cellpilot.radio import ColumnAntenna, element_gain_dbi


def _rows() -> list[dict[str, str]]:
    with open(Path(__file__).parents[1] / "vectors" / "antenna_vectors.csv") as file:
        return list(csv.DictReader(file))


azimuths = st.floats(-720.0, 720.0)
zeniths = st.floats(0.0, 180.0)


def test_every_reference_gain() -> None:
    rows = _rows()
    assert len(rows) == 129
    for row in rows:
        direction = float(row["azimuth_deg"]), float(row["zenith_deg"])
        if row["pattern"] == "38.901-element":
            got = element_gain_dbi(*direction)
        else:
            tilts = float(row["electrical_tilt_deg"]), float(row["mechanical_tilt_deg"])
            got = ColumnAntenna(int(row["n_vertical"]), float(row["spacing_lambda"]), *tilts).gain_dbi(*direction)
        assert got == pytest.approx(float(row["gain_dBi"]), abs=1e-5), row


@given(
    st.integers(1, 24), st.floats(0.1, 2.0), st.floats(-20.0, 20.0), st.one_of(zeniths, st.sampled_from([0.0, 90.0, 97.0, 180.0]))
)
def test_column_is_the_sum_over_its_elements(n: int, spacing: float, tilt: float, zenith: float) -> None:
    phases = 2 * np.pi * spacing * np.arange(n) * (np.cos(np.radians(zenith)) - np.cos(np.radians(90.0 + tilt)))
    power = np.abs(np.exp(1j * phases).sum()) ** 2 / n
    expected = element_gain_dbi(10.0, zenith) + max(10 * np.log10(max(power, 1e-30)), -40.0)
    assert ColumnAntenna(n, spacing, tilt).gain_dbi(10.0, zenith) == pytest.approx(expected, abs=1e-5)


@given(azimuths, zeniths, st.floats(-30.0, 30.0))
def test_gain_stays_within_peak_and_floor(azimuth: float, zenith: float, mechanical: float) -> None:
    gain = ColumnAntenna(10, 0.8, 7.0, mechanical).gain_dbi(azimuth, zenith)
    assert 8.0 - 30.0 - 40.0 - 1e-9 <= gain <= 18.0 + 1e-9


@given(azimuths, zeniths)
def test_left_right_symmetry_and_full_turns(azimuth: float, zenith: float) -> None:
    antenna = ColumnAntenna(8, 0.8, 4.0, 6.0)
    gain = antenna.gain_dbi(azimuth, zenith)
    assert antenna.gain_dbi(-azimuth, zenith) == pytest.approx(gain, abs=1e-6)
    assert antenna.gain_dbi(azimuth + 360.0, zenith) == pytest.approx(gain, abs=1e-6)


def test_mechanical_tilt_lowers_the_front_and_raises_the_back() -> None:
    flat, tilted = ColumnAntenna(8, 0.8, 0.0), ColumnAntenna(8, 0.8, 0.0, 6.0)
    assert tilted.gain_dbi(0.0, 96.0) == pytest.approx(flat.gain_dbi(0.0, 90.0))
    assert tilted.gain_dbi(180.0, 84.0) == pytest.approx(flat.gain_dbi(180.0, 90.0))


def test_nulls_are_filled_to_the_floor() -> None:
    null_zenith = np.degrees(np.arccos(1 / (10 * 0.8)))
    for floor in (-40.0, -20.0):
        gain = ColumnAntenna(10, 0.8, 0.0, array_factor_floor_db=floor).gain_dbi(0.0, null_zenith)
        assert gain == pytest.approx(element_gain_dbi(0.0, null_zenith) + floor)


def test_broadcasting() -> None:
    assert ColumnAntenna(4, 0.5, 0.0).gain_dbi(np.zeros((3, 1)), np.full(5, 90.0)).shape == (3, 5)


def test_ranges() -> None:
    with pytest.raises(RangeError, match=r"zenith is 181 deg; expected 0..180 deg"):
        element_gain_dbi(0.0, 181.0)
    with pytest.raises(RangeError, match="azimuth is nan deg; expected a finite number"):
        ColumnAntenna(4, 0.5, 0.0).gain_dbi(np.nan, 90.0)
    with pytest.raises(InputError, match="n_vertical is 0"):
        ColumnAntenna(0, 0.5, 0.0)
    with pytest.raises(InputError, match="spacing_wavelengths is -1"):
        ColumnAntenna(4, -1.0, 0.0)
    with pytest.raises(RangeError, match="electrical tilt is 91 deg"):
        ColumnAntenna(4, 0.5, 91.0)
