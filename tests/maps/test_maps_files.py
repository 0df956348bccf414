"""Maps on disk: the same after reading as before writing."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, load_map, make_map, save_map

LEVEL = st.floats(-60, 60, width=32) | st.just(float("nan"))


@st.composite
def radio_maps(draw: st.DrawFn) -> RadioMap:
    shape = draw(st.tuples(st.integers(1, 3), st.integers(1, 4), st.integers(2, 4)))
    sinr_db = draw(arrays(np.float32, shape, elements=LEVEL))
    sinr_db.flat[0] = 1.5
    step_m = draw(st.floats(0.1, 1000))
    n_sectors = draw(st.integers(1, 3))
    return make_map(
        sinr_db,
        x_m=step_m * np.arange(shape[2]),
        y_m=-100 + step_m * np.arange(shape[1]),
        z_m=np.array([20.0, 25.0, 50.0])[: shape[0]],
        source="test",
        sinr_std_db=draw(arrays(np.float32, shape, elements=st.floats(0, 9, width=32))),
        count=draw(arrays(np.int32, shape, elements=st.integers(0, 2**31 - 1))),
        filled=draw(arrays(np.bool_, shape)),
        optional={"rsrp_dbm": np.full((n_sectors, *shape), -80.0), "serving_sector": n_sectors - 1},
        sectors={"sector_name": np.array([f"Nö {i}" for i in range(n_sectors)]), "sector_x_m": np.arange(n_sectors)},
        anchor=draw(st.none() | st.builds(Anchor, st.floats(-89, 89), st.floats(-180, 180))),
        unknown=draw(st.sampled_from(["blocked", "bad"])),
        seed=draw(st.none() | st.integers(0, 2**31)),
        attributes={"note": draw(st.text(st.characters(exclude_categories=["C"])))},
    )


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dataset=radio_maps())
def test_round_trip(tmp_path: Path, dataset: RadioMap) -> None:
    save_map(dataset, tmp_path / "map.nc")
    loaded = load_map(tmp_path / "map.nc")
    xr.testing.assert_identical(loaded, dataset)
    assert {name: variable.dtype.kind for name, variable in loaded.variables.items()} == {
        name: variable.dtype.kind for name, variable in dataset.variables.items()
    }
    save_map(loaded, tmp_path / "again.nc")
    xr.testing.assert_identical(load_map(tmp_path / "again.nc"), dataset)


def test_a_failed_write_leaves_the_old_map_and_nothing_else(small_map: RadioMap, tmp_path: Path) -> None:
    save_map(small_map, tmp_path / "new" / "map.nc")
    with pytest.raises(InputError, match="no variable 'count'"):
        save_map(small_map.drop_vars("count"), tmp_path / "new" / "map.nc")
    with pytest.raises(TypeError):
        save_map(small_map.assign_attrs(note=object()), tmp_path / "new" / "map.nc")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["map.nc"]
    assert load_map(tmp_path / "new" / "map.nc").identical(small_map)


def test_a_place_that_cannot_be_written_is_named(small_map: RadioMap, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"map\.nc: cannot write the map"):
        save_map(small_map, tmp_path / "file" / "map.nc")


def damaged(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:3000])


@pytest.mark.parametrize(
    ("prepare", "message"),
    [
        (lambda path: path.unlink(), "no such file"),
        (lambda path: path.write_bytes(b""), "the file is empty"),
        (lambda path: path.write_text("Time,Latitude\n"), "not a readable NetCDF-4 file"),
        (damaged, "not a readable NetCDF-4 file"),
        (lambda path: xr.Dataset({"t": ("n", [1.0])}).to_netcdf(path, engine="h5netcdf"), "no attribute 'schema_version'"),
        (lambda path: (path.unlink(), path.mkdir()), "not a file"),
    ],
)
def test_a_wrong_file_is_refused_by_name(small_map: RadioMap, tmp_path: Path, prepare: object, message: str) -> None:
    path = tmp_path / "map.nc"
    save_map(small_map, path)
    assert callable(prepare)
    prepare(path)
    with pytest.raises(InputError, match=message) as caught:
        load_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_variable_at_fault_in_a_file_is_named(small_map: RadioMap, tmp_path: Path) -> None:
    small_map.drop_vars("filled").to_netcdf(tmp_path / "map.nc", engine="h5netcdf")
    with pytest.raises(InputError, match=r"map\.nc has no variable 'filled'"):
        load_map(tmp_path / "map.nc")
