"""Two maps beside each other, by hand numbers, and the grids that cannot be compared."""

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, make_map
from cellpilot.maps.compare import compared

NAN = np.nan
HERE, THERE = Anchor(47.0, 8.0), Anchor(47.0001, 8.0001)
A_DB = [[[0.0, 2.0, 4.0], [6.0, NAN, 3.0]], [[1.0, 1.0, 1.0], [1.0, 1.0, 1.0]]]
B_DB = [[[1.0, 2.0, 1.0], [8.0, 5.0, NAN]], [[3.0, 3.0, 3.0], [3.0, 3.0, 9.0]]]


def build(sinr_db: object, x0_m: float = 0.0, step_m: float = 20.0, z_m: tuple[float, ...] = (30.0, 52.5)) -> RadioMap:
    values = np.array(sinr_db, dtype=float)
    nz, ny, nx = values.shape
    return make_map(values, x_m=x0_m + step_m * np.arange(nx), y_m=step_m * np.arange(ny), z_m=z_m[:nz], source="test")


def test_by_hand() -> None:
    low, high, both = compared(build(A_DB), build(B_DB), 3.0)
    # Known in both at 30 m: A 0 2 4 6, B 1 2 1 8, so B less A is 1 0 -3 2.
    assert low[:4] == ("30", 4, 0.0, pytest.approx(np.sqrt(14 / 4)))
    # Deviations from the means 3 and 3: -3 -1 1 3 and -2 -1 -2 5.
    assert low.correlation == pytest.approx(20 / np.sqrt(20 * 34))
    assert low.agreement == 3 / 4
    # 3 dB is not below 3 dB, 1 dB is.
    assert high == (
        "52.5",
        6,
        pytest.approx(18 / 6),
        pytest.approx(np.sqrt((5 * 4 + 64) / 6)),
        pytest.approx(NAN, nan_ok=True),
        0,
    )
    assert both[:2] == ("all", 10)
    assert both.mean_db == pytest.approx(18 / 10)
    assert both.agreement == 3 / 10


def test_exchanged_maps_differ_by_the_opposite() -> None:
    for there, back in zip(compared(build(A_DB), build(B_DB), 3.0), compared(build(B_DB), build(A_DB), 3.0), strict=True):
        assert there.mean_db == pytest.approx(-back.mean_db)
        assert there[3:] == pytest.approx(back[3:], nan_ok=True)


def test_a_map_is_itself() -> None:
    (row,) = compared(build(A_DB[:1]), build(A_DB[:1]), 3.0)
    assert row == ("30", 5, 0.0, 0.0, pytest.approx(1.0), 1.0)


def test_maps_without_a_cell_in_common_say_nothing() -> None:
    (row,) = compared(build([[[1.0, 2.0, NAN]]]), build([[[NAN, NAN, 3.0]]]), 3.0)
    assert row == ("30", 0, *(pytest.approx(NAN, nan_ok=True),) * 4)


@pytest.mark.parametrize(
    ("other", "message"),
    [
        (build(B_DB, x0_m=10.0), "x has 3 from 0 to 40 m in a.nc and 3 from 10 to 50 m in b.nc"),
        (build(B_DB, step_m=21.0), "x has 3 from 0 to 40 m in a.nc and 3 from 0 to 42 m in b.nc"),
        (build(np.array(B_DB)[:, :, :2]), "x has 3 from 0 to 40 m in a.nc and 2 from 0 to 20 m in b.nc"),
        (build(np.array(B_DB)[:, :1]), "y has 2 from 0 to 20 m in a.nc and 1 from 0 to 0 m in b.nc"),
        (build(B_DB, z_m=(30.0, 50.0)), "z has 2 from 30 to 52.5 m in a.nc and 2 from 30 to 50 m in b.nc"),
    ],
)
def test_other_grids_are_refused_in_one_line(other: RadioMap, message: str) -> None:
    with pytest.raises(InputError) as caught:
        compared(build(A_DB), other, 3.0, "a.nc", "b.nc")
    assert str(caught.value).startswith(f"the grids differ: {message}; expected the same cells")
    assert "\n" not in str(caught.value)


def test_less_than_a_millimetre_is_no_difference() -> None:
    assert compared(build(A_DB), build(B_DB, x0_m=0.0005), 3.0)[-1].cells == 10


def test_equal_metres_in_other_places_are_other_grids() -> None:
    here, there = (
        make_map(np.zeros((1, 1, 2)), x_m=[0, 20], y_m=[0], z_m=[30], source="test", anchor=anchor) for anchor in (HERE, THERE)
    )
    assert compared(here, here, 3.0)[0].cells == 2
    with pytest.raises(InputError, match=r"x = y = 0 lies 1\d\.\d+ m apart in A and B"):
        compared(here, there, 3.0)
    nowhere = make_map(np.zeros((1, 1, 2)), x_m=[0, 20], y_m=[0], z_m=[30], source="test")
    assert compared(here, nowhere, 3.0)[0].cells == 2
