"""The schema: what a map is, and that each wrong one is refused by name."""

import re
import subprocess
import sys

import numpy as np
import pytest
import xarray as xr

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, anchor_of, grid_of, make_map, validate
from cellpilot.maps.fields import COORDINATES, FIELDS
from cellpilot.maps.reasons import blocked_cells

AXES = {"x_m": [0.0, 20.0], "y_m": [0.0], "z_m": [30.0]}


def test_unknown_cells_are_blocked_and_everything_has_units(small_map: RadioMap) -> None:
    assert np.array_equal(blocked_cells(small_map), np.isnan(small_map["sinr_db"].values))
    for name, variable in small_map.variables.items():
        field = (FIELDS | COORDINATES)[str(name)]
        assert variable.dtype == field.dtype
        assert variable.attrs["units"] == field.units
        assert variable.attrs["long_name"]
    assert small_map.attrs["schema_version"] == 2
    assert anchor_of(small_map) is None
    assert "datum" not in small_map.attrs


def test_anchor_goes_in_and_comes_out() -> None:
    anchor = Anchor(47.5, 8.5, 400.0)
    assert anchor_of(make_map([[[1.0, 2.0]]], **AXES, source="test", anchor=anchor)) == anchor


def test_grid_has_the_cells_of_the_map(small_map: RadioMap) -> None:
    grid = grid_of(small_map)
    assert grid.sides == (4, 3, 2)
    place_m = grid.metres(grid.cell((3, 1, 1)))
    assert place_m.tolist() == [60.0, 20.0, 50.0]
    assert small_map["sinr_db"].values.ravel()[grid.cell((3, 1, 1))] == small_map["sinr_db"].sel(x=60, y=20, z=50)


def test_unknown_bad_leaves_cells_free() -> None:
    dataset = make_map([[[1.0, np.nan]]], **AXES, source="test", unknown="bad")
    assert not blocked_cells(dataset).any()
    assert dataset.attrs["unknown"] == "bad"


def test_other_number_types_are_converted_if_nothing_is_lost(small_map: RadioMap) -> None:
    foreign = small_map.assign(
        sinr_db=small_map["sinr_db"].astype(np.float64),
        filled=small_map["filled"].astype(np.int8),
        count=small_map["count"] * 1.0,
    )
    assert validate(foreign).identical(small_map)


def test_sector_coordinates_may_arrive_as_variables() -> None:
    dataset = make_map([[[1.0, 2.0]]], **AXES, source="test", sectors={"sector_x_m": [0.0, 1.0], "sector_name": ["a", "b"]})
    assert validate(dataset.reset_coords(["sector_x_m", "sector_name"])).identical(dataset)


def with_values(name: str, value: float) -> object:
    return lambda d: d.assign({name: xr.full_like(d["sinr_db" if name == "blocked" else name], value, dtype=np.float64)})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda d: d.drop_vars("sinr_std_db"), "no variable 'sinr_std_db'"),
        (lambda d: d.drop_vars("blocked_reason"), "no variable 'blocked_reason'"),
        (lambda d: d.drop_vars("x"), "no coordinate 'x'"),
        (lambda d: d.transpose("x", "y", "z"), "sinr_db has the dimensions ('x', 'y', 'z')"),
        (lambda d: d.assign(sinr_db=d["sinr_db"].isel(z=0, drop=True)), "sinr_db has the dimensions ('y', 'x')"),
        (lambda d: d.isel(x=slice(None, None, -1)), "coordinate x does not increase"),
        (lambda d: d.isel(x=[0, 1, 3]), "coordinate x is uneven (steps 20 to 40 m)"),
        (lambda d: d.assign_coords(y=[0.0, np.nan, 2.0]), "coordinate y is empty or not finite"),
        (
            lambda d: d.assign(blocked_reason=d["blocked_reason"] * 0),
            "sinr_db is NaN in 2 free cell(s), the first at (z, y, x) = (0, 1, 2)",
        ),
        (with_values("sinr_db", np.inf), "sinr_db has 24 infinite value(s)"),
        (with_values("sinr_db", 1e60), "sinr_db holds values that are not float32"),
        (with_values("sinr_std_db", -1), "sinr_std_db holds -1"),
        (with_values("sinr_std_db", np.nan), "sinr_std_db is negative or NaN"),
        (with_values("count", -1), "count is negative"),
        (with_values("count", 0.5), "count holds values that are not int32"),
        (with_values("blocked_reason", 0.5), "blocked_reason holds values that are not uint8"),
        (with_values("blocked_reason", 256), "blocked_reason holds values that are not uint8"),
        (with_values("blocked_reason", 2), "blocked_reason is 2 in a cell; expected at most 1"),
        (with_values("blocked", 1), "variable 'blocked' of schema version 1"),
        (lambda d: d.assign_attrs(blocked_reasons="[{}]"), "blocked_reasons is no table of reasons ({} has no name)"),
        (lambda d: d.assign_attrs(blocked_reasons='[{"name": "x", "color": 1}]'), "'color' is none of name, source"),
        (lambda d: d.assign_attrs(blocked_reasons='[{"name": "x", "upper_m": NaN}]'), "upper_m is nan"),
        (lambda d: d.assign_attrs(blocked_reasons='[{"name": "x", "lack_of_data": 1}]'), "lack_of_data is 1"),
        (lambda d: d.assign_attrs(schema_version=1), "no variable 'blocked'"),
        (with_values("blocked_reason", 1), "every cell is blocked"),
        (lambda d: d.assign(sinr_db=d["sinr_db"].astype(str)), "sinr_db is of type"),
        (lambda d: d.assign(sinr_spread_db=d["sinr_std_db"] - 1), "sinr_spread_db is negative"),
        (lambda d: d.assign(serving_sector=d["count"] - 2), "serving_sector holds -2"),
        (lambda d: d.isel(x=[0], y=[0], z=[0]), "has 1 cell; a flight needs at least 2"),
        (lambda d: d.expand_dims(condition=2), "reserved dimension 'condition'"),
        (lambda d: d.drop_attrs(deep=False), "no attribute 'schema_version'"),
        (lambda d: d.assign_attrs(schema_version=3), "schema_version 3; this cellpilot reads 1 and 2"),
        (lambda d: d.assign_attrs(unknown="perhaps"), "unknown = 'perhaps'"),
        (lambda d: d.assign_attrs(anchor_latitude_deg=3.0), "only one of anchor_latitude_deg"),
        (lambda d: d.assign_attrs(anchor_latitude_deg=300.0, anchor_longitude_deg=3.0), "latitude is 300"),
        (
            lambda d: d.assign_attrs(anchor_latitude_deg="n", anchor_longitude_deg=3.0),
            "anchor_latitude_deg is 'n'",
        ),
    ],
)
def test_a_wrong_map_is_refused_by_name(small_map: RadioMap, change: object, message: str) -> None:
    assert callable(change)
    wrong = change(small_map)
    with pytest.raises(InputError, match=re.escape(message)) as caught:
        validate(wrong, "field.nc")
    assert "field.nc" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_serving_sector_must_exist() -> None:
    with pytest.raises(InputError, match="serving_sector holds 2 to 2"):
        make_map([[[1.0, 2.0]]], **AXES, source="test", optional={"serving_sector": 2}, sectors={"sector_x_m": [0.0, 1.0]})


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"sinr_db": [1.0, 2.0]}, "sinr_db has 1 dimension"),
        ({"x_m": [0.0, 20.0, 40.0]}, "do not fit together"),
        ({"optional": {"sinr": 1.0}}, "'sinr' is no variable"),
        ({"sectors": {"sector_colour": [1.0]}}, "'sector_colour' is no variable"),
        ({"sectors": {"sector_x_m": [1.0], "sector_y_m": [1.0, 2.0]}}, "do not fit together"),
    ],
)
def test_make_map_refuses_what_does_not_fit(arguments: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message) as caught:
        make_map(**({"sinr_db": [[[1.0, 2.0]]], **AXES, "source": "test"} | arguments))  # type: ignore[arg-type]
    assert "\n" not in str(caught.value)


def test_importing_the_package_does_not_import_xarray() -> None:
    code = (
        "import sys, cellpilot.maps; assert 'xarray' not in sys.modules; cellpilot.maps.make_map; assert 'xarray' in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
