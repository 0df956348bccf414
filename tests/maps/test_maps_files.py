"""Maps on disk: the same after reading as before writing."""

import os
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, anchor_of, fill, load_map, make_map, save_map
from cellpilot.maps.formats.cells import VARIABLES
from cellpilot.maps.reasons import (
    IN_FILE,
    IN_FILE_WITHOUT_SINR,
    INSIDE_BUILDING,
    NO_SINR,
    Reason,
    blocked_cells,
    reasons_of,
    reasons_text,
)
from cellpilot.maps.text_table import Column, open_table

TEXT = st.text(st.characters(exclude_categories=["C"]), max_size=20)
HEIGHT_M = st.none() | st.floats(-100, 10_000) | st.integers(-100, 10_000)
REASON = st.builds(Reason, TEXT, TEXT, HEIGHT_M, HEIGHT_M, TEXT, TEXT, st.booleans())
LEVEL = st.floats(-60, 60, width=32) | st.just(float("nan"))


@st.composite
def radio_maps(draw: st.DrawFn) -> RadioMap:
    shape = draw(st.tuples(st.integers(1, 3), st.integers(1, 4), st.integers(2, 4)))
    sinr_db = draw(arrays(np.float32, shape, elements=LEVEL))
    sinr_db.flat[0] = 1.5
    step_m = draw(st.floats(0.1, 1000))
    n_sectors = draw(st.integers(1, 3))
    unknown = draw(st.sampled_from(["blocked", "bad"]))
    reasons = tuple(draw(st.lists(REASON, min_size=1, max_size=4)))
    least = (np.isnan(sinr_db) & (unknown == "blocked")).astype(np.uint8)
    blocked_reason = np.maximum(draw(arrays(np.uint8, shape, elements=st.integers(0, len(reasons)))), least)
    blocked_reason.flat[0] = 0
    return make_map(
        sinr_db,
        x_m=step_m * np.arange(shape[2]),
        y_m=-100 + step_m * np.arange(shape[1]),
        z_m=np.array([20.0, 25.0, 50.0])[: shape[0]],
        source="test",
        sinr_std_db=draw(arrays(np.float32, shape, elements=st.floats(0, 9, width=32))),
        count=draw(arrays(np.int32, shape, elements=st.integers(0, 2**31 - 1))),
        filled=draw(arrays(np.bool_, shape)),
        blocked_reason=blocked_reason,
        reasons=reasons,
        optional={"rsrp_dbm": np.full((n_sectors, *shape), -80.0), "serving_sector": n_sectors - 1},
        sectors={"sector_name": np.array([f"Nö {i}" for i in range(n_sectors)]), "sector_x_m": np.arange(n_sectors)},
        anchor=draw(st.none() | st.builds(Anchor, st.floats(-89, 89), st.floats(-180, 180))),
        unknown=unknown,
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


@pytest.mark.parametrize("suffix", [".csv", ".tif"])
@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(dataset=radio_maps())
def test_what_belongs_to_cells_survives_csv_and_geotiff(tmp_path: Path, suffix: str, dataset: RadioMap) -> None:
    if suffix == ".tif" and anchor_of(dataset) is None:
        dataset.attrs |= {"anchor_latitude_deg": 50.0, "anchor_longitude_deg": 180.0}
    dataset["count"] = dataset["count"].clip(max=2**31 - 2, keep_attrs=True)  # in text, 2^31 - 1 is no value
    save_map(dataset, tmp_path / f"map{suffix}")
    loaded = load_map(tmp_path / f"map{suffix}")
    xr.testing.assert_identical(loaded, dataset[[name for name in VARIABLES if name in dataset]])


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".csv", ".tif"])
def test_attributes_may_be_arrays(small_map: RadioMap, tmp_path: Path, suffix: str) -> None:
    anchor = {"anchor_latitude_deg": np.float64(50), "anchor_longitude_deg": np.float64(7)}
    odd = small_map.assign_attrs(bands=np.array([1.5, 2.0]), n=np.int64(3), few=np.float32(0.5), **anchor)
    save_map(odd, tmp_path / f"map{suffix}")
    back = load_map(tmp_path / f"map{suffix}").attrs
    assert list(back["bands"]) == [1.5, 2.0]
    assert (back["n"], back["few"], back["anchor_longitude_deg"]) == (3, 0.5, 7.0)
    with pytest.raises(InputError, match=r"the attribute note is <object.*>; expected text, a number"):
        save_map(odd.assign_attrs(note=object()), tmp_path / f"odd{suffix}")
    assert not (tmp_path / f"odd{suffix}").exists()


def test_a_failed_write_leaves_the_old_map_and_nothing_else(small_map: RadioMap, tmp_path: Path) -> None:
    save_map(small_map, tmp_path / "new" / "map.nc")
    with pytest.raises(InputError, match="no variable 'count'"):
        save_map(small_map.drop_vars("count"), tmp_path / "new" / "map.nc")
    with pytest.raises(InputError, match="the attribute note is <object"):
        save_map(small_map.assign_attrs(note=object()), tmp_path / "new" / "map.nc")
    assert [path.name for path in (tmp_path / "new").iterdir()] == ["map.nc"]
    assert load_map(tmp_path / "new" / "map.nc").identical(small_map)


def test_a_place_that_cannot_be_written_is_named(small_map: RadioMap, tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match=r"map\.nc: cannot be written"):
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


@pytest.mark.parametrize("suffix", [".nc", ".zarr", ".csv", ".tif"])
def test_reasons_survive_every_format(small_map: RadioMap, tmp_path: Path, suffix: str) -> None:
    small_map["blocked_reason"].values[0, 0] = [2, 3, 0, 0]
    airport = Reason("control zone", "lba.geojson", 0.0, 450, "above the ground", "Mon-Fri", False)
    table = reasons_text((NO_SINR, INSIDE_BUILDING, airport, Reason("of no cell")))
    there = small_map.assign_attrs(blocked_reasons=table, anchor_latitude_deg=50.0, anchor_longitude_deg=7.0)
    save_map(there, tmp_path / f"map{suffix}")
    loaded = load_map(tmp_path / f"map{suffix}")
    xr.testing.assert_identical(loaded, there)
    assert reasons_of(loaded)[2] == airport


@pytest.mark.parametrize("suffix", [".nc", ".csv"])
def test_a_map_of_schema_version_1_has_two_reasons(small_map: RadioMap, tmp_path: Path, suffix: str) -> None:
    small_map["blocked_reason"].values[0, 0, 0] = 1
    path = tmp_path / f"map{suffix}"
    if suffix == ".nc":
        old = small_map.drop_vars("blocked_reason").assign(blocked=small_map["blocked_reason"] > 0)
        del old.attrs["blocked_reasons"]
        old.assign_attrs(schema_version=1).to_netcdf(path, engine="h5netcdf")
    else:
        lines = ["x_m,y_m,z_m,sinr_db,blocked"]
        for z, y, x in np.ndindex(small_map["sinr_db"].shape):
            sinr_db, blocked = small_map["sinr_db"].values[z, y, x], int(small_map["blocked_reason"].values[z, y, x])
            lines.append(f"{20 * x},{20 * y},{30 + 20 * z},{'' if np.isnan(sinr_db) else sinr_db},{blocked}")
        path.write_text('# cellpilot map {"schema_version": 1, "source": "test"}\n' + "\n".join(lines) + "\n")
    loaded = load_map(path)
    assert loaded.attrs["schema_version"] == 2
    assert reasons_of(loaded) == (IN_FILE, IN_FILE_WITHOUT_SINR)
    assert loaded["blocked_reason"].values.ravel().nonzero()[0].tolist() == [0, 6, 18]
    assert loaded["blocked_reason"].values.ravel()[[0, 6, 18]].tolist() == [1, 2, 2]
    assert not blocked_cells(fill(loaded, 25.0)).ravel()[[6, 18]].any()


def test_a_csv_made_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("x_m,y_m,z_m,sinr_db\n0,0,30,5\n20,0,30,-3.5\n0,20,30,7\n")
    dataset = load_map(path)
    assert dataset.sizes == {"z": 1, "y": 2, "x": 2}
    assert blocked_cells(dataset).tolist() == [[[False, False], [False, True]]]
    path.write_text("x_m,y_m,z_m,sinr_db\n0,0,30,5\n20,0,30,-3.5\n0,0,30,7\n")
    with pytest.raises(InputError, match=r"map\.csv, line 4: the cell at \[0\.0, 0\.0, 30\.0\] is there already"):
        load_map(path)
    path.write_text("x_m,y_m,z_m,sinr_db,count,blocked\n0,0,30,5,,0\n20,0,30,-3.5,2,0\n0,20,30,7,1,\n20,20,30,7,1,0\n")
    assert load_map(path)["count"].values.tolist() == [[[0, 2], [1, 1]]]
    assert blocked_cells(load_map(path)).tolist() == [[[False, False], [True, False]]]
    path.write_text("x,y,z,sinr_db\n0,0,30,5\n")
    with pytest.raises(InputError, match=r"line 1: no column 'x_m'"):
        load_map(path)


def test_what_a_format_cannot_do(small_map: RadioMap, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.xlsx: maps are read from and written to \.nc"):
        save_map(small_map, tmp_path / "map.xlsx")
    with pytest.raises(InputError, match=r"map\.tif: the map lies nowhere on Earth; give it an anchor"):
        save_map(small_map, tmp_path / "map.tif")
    with pytest.raises(InputError, match=r"map\.nc: one variable alone can be asked of GeoTIFF only"):
        save_map(small_map, tmp_path / "map.nc", variable="count")
    save_map(small_map, tmp_path / "map.nc")
    with pytest.raises(InputError, match=r"map\.nc: heights of bands can be asked of GeoTIFF only"):
        load_map(tmp_path / "map.nc", heights_m=(30.0, 50.0))


def test_a_folder_that_is_no_store_stays(small_map: RadioMap, tmp_path: Path) -> None:
    (tmp_path / "notes.zarr").mkdir()
    (tmp_path / "notes.zarr" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=re.escape("notes.zarr: a folder that is no Zarr store")):
        save_map(small_map, tmp_path / "notes.zarr")
    assert (tmp_path / "notes.zarr" / "mine.txt").exists()
    with pytest.raises(InputError, match="not a readable Zarr store"):
        load_map(tmp_path / "notes.zarr")


@pytest.mark.parametrize("survived", [0, 1])
def test_a_kill_never_takes_the_old_store(
    small_map: RadioMap, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, survived: int
) -> None:
    path = tmp_path / "map.zarr"
    save_map(small_map, path)
    new, renames = small_map.assign_attrs(source="new"), []

    def killed_at(rename: Callable[[Path, Path], None]) -> Callable[[Path, Path], None]:
        def renamed(source: Path, target: Path) -> None:
            if Path(source).parent == tmp_path:  # not what Zarr renames within a store
                renames.append(source)
                if len(renames) > survived:
                    raise KeyboardInterrupt
            rename(source, target)

        return renamed

    with monkeypatch.context() as patch:
        patch.setattr(os, "rename", killed_at(os.rename))
        patch.setattr(os, "replace", killed_at(os.replace))
        with pytest.raises(KeyboardInterrupt):
            save_map(new, path)
    assert any(xr.open_zarr(store).load().equals(small_map) for store in tmp_path.iterdir())
    save_map(new, path)
    assert load_map(path).identical(new)
    assert [each.name for each in tmp_path.iterdir()] == ["map.zarr"]


def test_a_link_to_a_store_stays_a_link(small_map: RadioMap, tmp_path: Path) -> None:
    save_map(small_map, tmp_path / "map.zarr")
    (tmp_path / "link.zarr").symlink_to("map.zarr")
    save_map(small_map.assign_attrs(source="new"), tmp_path / "link.zarr")
    assert (tmp_path / "link.zarr").is_symlink()
    assert load_map(tmp_path / "map.zarr").attrs["source"] == "new"


def test_a_byte_that_is_not_text_is_named_with_its_line(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    for end in (b"\n", b"\r\n", b"\r"):
        path.write_bytes(end.join([b"\xef\xbb\xbfa,b", *[b"\xc3\xa9,2"] * 200, b"caf\xe9,3", b"1,2", b"\xff"]))
        with pytest.raises(InputError, match=r"table\.csv, line 202: not readable as text \(the byte 0xe9 there is not UTF-8\)"):
            list(open_table(path, "table")[1])
    path.write_bytes(b"a,b\n1,2\n" + b"x" * 200_000 + b",3\n4,5\n")
    with pytest.raises(InputError, match=r"table\.csv, line 3: not readable as text \(field larger"):
        list(open_table(path, "table")[1])


@pytest.mark.parametrize(
    ("text", "names", "line", "latitudes"),
    [
        ("radio,lat,lon\nLTE,1,2\n", ("radio", "lat", "lon"), 1, {2: 1.0}),
        ("LTE,1,2\nGSM,3,4\n", ("radio", "lat", "lon"), 1, {1: 1.0, 2: 3.0}),
        ("\n# made by hand\nLTE;1;2\n", ("radio", "lat", "lon"), 3, {3: 1.0}),
        ("lon,lat\n2,1\n", ("lon", "lat"), 1, {2: 1.0}),
    ],
)
def test_a_table_with_or_without_a_header_line(
    tmp_path: Path, text: str, names: tuple[str, ...], line: int, latitudes: dict[int, float]
) -> None:
    (tmp_path / "cells.csv").write_text(text)
    table, rows = open_table(tmp_path / "cells.csv", "list of cells", ("radio", "lat", "lon"))
    assert (table.names, table.line) == (names, line)
    assert {row.line: row.number(Column("lat", -90, 90)) for row in rows} == latitudes
    (tmp_path / "cells.csv").write_text("")
    with pytest.raises(InputError, match=r"the file is empty; expected a list of cells$"):
        open_table(tmp_path / "cells.csv", "list of cells", ("radio", "lat", "lon"))
