"""LOS probability, path loss and shadowing spread: reference vectors, properties, ranges."""

import csv
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot.errors import InputError, RangeError
from cellpilot.radio import ENVIRONMENTS, los_probability, path_loss_db, shadow_std_db

VECTORS = Path(__file__).parents[1] / "vectors"


def _rows(name: str) -> list[dict[str, str]]:
    with open(VECTORS / name) as file:
        return list(csv.DictReader(file))


ROWS = _rows("tr36777_vectors.csv")
environments = st.sampled_from(sorted(ENVIRONMENTS))
distances = st.floats(0.0, 20e3)
heights = st.floats(1.5, 300.0)


def test_all_45_links_are_there() -> None:
    assert len(ROWS) == 45


@pytest.mark.parametrize("row", ROWS, ids=lambda row: f"{row['scenario']}-{row['d2d_m']}m-{row['h_ut_m']}m")
def test_every_reference_link(row: dict[str, str]) -> None:
    environment, distance, height = row["scenario"], float(row["d2d_m"]), float(row["h_ut_m"])
    link = (environment, float(row["fc_GHz"]) * 1e9, distance, float(row["h_bs_m"]), height)
    got = [los_probability(environment, distance, height), *path_loss_db(*link), *shadow_std_db(*link)]
    columns = ("los_probability", "pathloss_los_dB", "pathloss_nlos_dB", "sf_std_los_dB", "sf_std_nlos_dB")
    np.testing.assert_allclose(got, [float(row[name]) for name in columns], rtol=0, atol=1e-5, equal_nan=True)


def test_arrays_give_what_single_links_give() -> None:
    for environment in ENVIRONMENTS:
        rows = [row for row in ROWS if row["scenario"] == environment]
        carrier, distance, base, height = (
            np.array([float(row[name]) for row in rows]) for name in ("fc_GHz", "d2d_m", "h_bs_m", "h_ut_m")
        )
        los, nlos = path_loss_db(environment, carrier * 1e9, distance, base, height)
        np.testing.assert_allclose(los, [float(row["pathloss_los_dB"]) for row in rows], rtol=0, atol=1e-5)
        np.testing.assert_allclose(nlos, [float(row["pathloss_nlos_dB"]) for row in rows], rtol=0, atol=1e-5)


@pytest.mark.parametrize("environment", ENVIRONMENTS)
def test_broadcasting(environment: str) -> None:
    distance, height = np.linspace(0, 3000, 7)[:, None], np.array([1.5, 30.0, 90.0])
    assert los_probability(environment, distance, height).shape == (7, 3)
    for function in (path_loss_db, shadow_std_db):
        los, nlos = function(environment, 2e9, distance, 25.0, height)
        assert los.shape == nlos.shape == (7, 3)


@given(environments, distances, heights)
def test_probability_lies_in_0_1(environment: str, distance: float, height: float) -> None:
    assert 0.0 <= los_probability(environment, distance, height) <= 1.0


def test_ground_uma_probability_is_cut_at_1() -> None:
    # The product of Table 7.4.2-1 is 1.005 here.
    assert los_probability("UMa-AV", 18.1, 22.5) == 1.0


@given(environments, distances, st.floats(1.5, 150.0), heights)
def test_path_loss_is_finite_and_nlos_only_missing_where_certain(
    environment: str, distance: float, base_height: float, height: float
) -> None:
    los, nlos = path_loss_db(environment, 2e9, distance, base_height, height)
    assert np.isfinite(los)
    if np.isnan(nlos):
        assert los_probability(environment, distance, height) == 1.0


@given(st.sampled_from(["RMa-AV", "UMi-AV"]), distances, heights)
def test_nlos_never_loses_less_than_los_where_the_table_has_a_max(environment: str, distance: float, height: float) -> None:
    los, nlos = path_loss_db(environment, 2e9, distance, 30.0, height)
    assert nlos >= los


def test_documented_jump_of_uma() -> None:
    below, above = los_probability("UMa-AV", 500.0, [22.5, 22.6])
    assert below < 0.23
    assert above > 0.78


def test_distances_are_floored_over_the_mast() -> None:
    here, floor, one_metre = (path_loss_db("UMa-AV", 2e9, d, 25.0, 25.0)[0] for d in (0.0, 0.5, 1.0))
    assert here == floor == one_metre


@pytest.mark.parametrize("height", [1.4, 300.1, -5.0, np.nan, np.inf])
def test_heights_outside_the_tables(height: float) -> None:
    for call in (
        lambda: los_probability("UMa-AV", 100.0, [30.0, height]),
        lambda: path_loss_db("UMa-AV", 2e9, 100.0, 25.0, height),
        lambda: shadow_std_db("UMa-AV", 2e9, 100.0, 25.0, height),
    ):
        with pytest.raises(RangeError, match=rf"height is {height:g} m; expected 1.5..300 m"):
            call()


def test_other_ranges() -> None:
    with pytest.raises(RangeError, match=r"carrier is 2 Hz; expected 5e\+08..1e\+11 Hz"):
        path_loss_db("UMa-AV", 2.0, 100.0, 25.0, 30.0)
    with pytest.raises(RangeError, match="horizontal distance is -1 m; expected at least 0 m"):
        los_probability("UMa-AV", -1.0, 30.0)
    with pytest.raises(RangeError, match="mast height is 0 m"):
        path_loss_db("UMa-AV", 2e9, 100.0, 0.0, 30.0)
    with pytest.raises(InputError, match="environment is 'Uma'; expected one of RMa-AV, UMa-AV, UMi-AV"):
        los_probability("Uma", 100.0, 30.0)
    with pytest.raises(InputError, match="expected numbers"):
        los_probability("UMa-AV", "far", 30.0)  # type: ignore[arg-type]
