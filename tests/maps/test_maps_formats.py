"""Files of maps: what each format keeps, what other programs read in them, and what is refused."""

import json
import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st
from pyproj import Geod

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, anchor_of, load_map, make_map, save_map, simulate_map, to_degrees, to_local
from cellpilot.maps.formats import geotiff
from cellpilot.radio import hexagonal_deployment

ANCHOR = Anchor(51.9, -8.4)


@pytest.fixture
def anchored() -> RadioMap:
    """Two heights of 3 x 4 cells of 20 x 25 m with holes, blocked and filled cells."""
    rng = np.random.default_rng(0)
    sinr_db = rng.normal(0, 8, (2, 3, 4)).astype(np.float32)
    sinr_db[:, 1, 2] = np.nan
    return make_map(
        sinr_db,
        x_m=np.arange(4) * 20.0 - 30,
        y_m=np.arange(3) * 25.0 + 100,
        z_m=[30.0, 47.5],
        source="test",
        sinr_std_db=np.where(np.isnan(sinr_db), np.nan, 0.5).astype(np.float32),
        count=rng.integers(1, 9, (2, 3, 4)),
        optional={"sinr_spread_db": np.abs(sinr_db)},
        anchor=ANCHOR,
        licence="CC0",
        attributes={"bin_m": 20.0},
    )


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_netcdf_and_zarr_keep_everything(anchored: RadioMap, tmp_path: Path, suffix: str) -> None:
    simulated = simulate_map(hexagonal_deployment(), x_range_m=(0.0, 60.0), y_range_m=(0.0, 40.0), points_per_side=2)
    for number, dataset in enumerate((anchored, simulated)):
        save_map(dataset, tmp_path / f"{number}{suffix}")
        save_map(dataset, tmp_path / f"{number}{suffix}")  # and once more over it
        xr.testing.assert_identical(load_map(tmp_path / f"{number}{suffix}"), dataset)


def test_csv_keeps_all_cells(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.csv")
    xr.testing.assert_identical(load_map(tmp_path / "map.csv"), anchored)
    lines = (tmp_path / "map.csv").read_text().splitlines()
    assert len(lines) == 2 + 24
    first = dict(zip(lines[1].split(","), lines[2].split(","), strict=True))
    latitude, longitude = to_degrees(-30.0, 100.0, ANCHOR)
    assert float(first["latitude"]) == float(latitude)
    assert float(first["longitude"]) == float(longitude)


def test_a_csv_made_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "map.csv"
    path.write_text("x_m,y_m,z_m,sinr_db\n0,0,30,5\n20,0,30,-3.5\n0,20,30,7\n")
    dataset = load_map(path)
    assert dataset.sizes == {"z": 1, "y": 2, "x": 2}
    assert dataset["blocked"].values.tolist() == [[[False, False], [False, True]]]
    path.write_text("x_m,y_m,z_m,sinr_db\n0,0,30,5\n20,0,30,-3.5\n0,0,30,7\n")
    with pytest.raises(InputError, match=r"map\.csv, line 4: the cell at \[0\.0, 0\.0, 30\.0\] is there already"):
        load_map(path)
    path.write_text("x,y,z,sinr_db\n0,0,30,5\n")
    with pytest.raises(InputError, match=r"line 1: no column 'x_m'"):
        load_map(path)


def test_geotiff_comes_back_equal(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    back = load_map(tmp_path / "map.tif")
    for name in ("sinr_db", "x", "y", "z"):
        np.testing.assert_array_equal(back[name].values, anchored[name].values)
    assert back.attrs == anchored.attrs
    assert anchor_of(back) == ANCHOR
    geotiff.write(anchored, tmp_path / "count.tif", "count")
    with pytest.raises(InputError, match="holds count, not SINR"):
        load_map(tmp_path / "count.tif")


def test_geotiff_lies_where_the_map_lies(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.crs == "EPSG:4326"
        assert file.descriptions == ("sinr_db at 30 m", "sinr_db at 47.5 m")
        assert file.units == ("dB", "dB")
        assert np.isnan(file.nodata)
        corners = {(0, 0): (-40.0, 162.5), (4, 3): (40.0, 87.5)}  # column, row of the raster: x, y of the outer corner
        for (column, row), (x_m, y_m) in corners.items():
            longitude, latitude = file.xy(row, column, offset="ul")
            expected_latitude, expected_longitude = to_degrees(x_m, y_m, ANCHOR)
            _, _, off_m = Geod(ellps="WGS84").inv(longitude, latitude, float(expected_longitude), float(expected_latitude))
            assert off_m < 1e-3
        np.testing.assert_array_equal(file.read(1)[0], anchored["sinr_db"].values[0, -1])


@pytest.mark.skipif(
    shutil.which("gdalinfo") is None and not os.environ.get("CI"), reason="gdalinfo (Debian: gdal-bin) is not installed"
)
def test_gdalinfo_reads_corners_and_values(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    told = subprocess.run(["gdalinfo", "-json", "-stats", "map.tif"], cwd=tmp_path, capture_output=True, text=True, check=True)
    about = json.loads(told.stdout)
    longitude, latitude = about["cornerCoordinates"]["upperLeft"]
    expected_latitude, expected_longitude = to_degrees(-40.0, 162.5, ANCHOR)
    _, _, off_m = Geod(ellps="WGS84").inv(longitude, latitude, float(expected_longitude), float(expected_latitude))
    assert off_m < 1.0
    for iz, band in enumerate(about["bands"]):
        assert band["unit"] == "dB"
        assert band["mean"] == pytest.approx(float(np.nanmean(anchored["sinr_db"].values[iz].astype(float))), abs=1e-3)


def test_a_projected_raster_from_elsewhere(tmp_path: Path) -> None:
    path = tmp_path / "utm.tif"
    values = np.arange(200, dtype=np.float32).reshape(1, 10, 20)
    values[0, 3, 4] = -9999
    profile = {"driver": "GTiff", "width": 20, "height": 10, "count": 1, "dtype": "float32", "crs": "EPSG:32629", "nodata": -9999}
    with rasterio.open(path, "w", transform=rasterio.Affine(30, 0, 540_000, 0, -30, 5_750_000), **profile) as file:
        file.write(values)
    with pytest.raises(InputError, match=r"1 band\(s\) without a height; give one for each: --heights-m"):
        load_map(path)
    with pytest.raises(InputError, match=r"1 band\(s\), and 2 height\(s\) given"):
        geotiff.read(path, (30.0, 40.0))
    dataset = geotiff.read(path, (30.0,))
    assert dataset["z"].values.tolist() == [30.0]
    assert dataset.sizes["x"] in (20, 21)
    assert np.diff(dataset["x"].values)[0] == pytest.approx(30.0, rel=0.01)
    # The middle of a pixel, taken to local metres by another library, has that pixel's value.
    from pyproj import Transformer

    to_wgs84 = Transformer.from_crs("EPSG:32629", "EPSG:4326", always_xy=True)
    anchor = anchor_of(dataset)
    assert anchor is not None
    for row, column in ((5, 10), (2, 3), (8, 17)):
        longitude, latitude = to_wgs84.transform(540_000 + 30 * (column + 0.5), 5_750_000 - 30 * (row + 0.5))
        x_m, y_m = to_local(latitude, longitude, anchor)
        near = dataset["sinr_db"].sel(x=float(x_m), y=float(y_m), method="nearest").values[0]
        assert abs(near - values[0, row, column]) in (0.0, 1.0, 20.0)  # the pixel itself, or one the centre of the cell lies in
    assert np.isnan(dataset["sinr_db"].values).any()


def test_what_is_refused(anchored: RadioMap, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"map\.xlsx: maps are read from and written to \.nc"):
        save_map(anchored, tmp_path / "map.xlsx")
    nowhere = make_map(np.zeros((1, 2, 2)), x_m=[0, 20], y_m=[0, 20], z_m=[30], source="test")
    with pytest.raises(InputError, match="the map lies nowhere on Earth; give it an anchor"):
        save_map(nowhere, tmp_path / "map.tif")
    with pytest.raises(InputError, match="the map has no rsrp_dbm"):
        geotiff.write(anchored, tmp_path / "map.tif", "rsrp_dbm")
    profile = {"driver": "GTiff", "width": 2, "height": 2, "count": 1, "dtype": "float32"}
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning), rasterio.open(tmp_path / "plain.tif", "w", **profile) as file:
        file.write(np.zeros((1, 2, 2), np.float32))
    with pytest.raises(InputError, match=r"plain\.tif: no coordinate system"):
        load_map(tmp_path / "plain.tif")
    (tmp_path / "text.tif").write_text("not a picture")
    with pytest.raises(InputError, match=r"text\.tif: not a readable GeoTIFF"):
        load_map(tmp_path / "text.tif")
    (tmp_path / "notes.zarr").mkdir()
    (tmp_path / "notes.zarr" / "mine.txt").write_text("keep")
    with pytest.raises(InputError, match=re.escape("notes.zarr: a folder that is no Zarr store")):
        save_map(anchored, tmp_path / "notes.zarr")
    assert (tmp_path / "notes.zarr" / "mine.txt").exists()
    with pytest.raises(InputError, match="not a readable Zarr store"):
        load_map(tmp_path / "notes.zarr")


@settings(max_examples=15, deadline=None)
@given(st.integers(1, 3), st.integers(1, 4), st.integers(2, 4), st.floats(1.0, 300.0), st.floats(-80, 80), st.floats(-180, 180))
def test_any_grid_survives_a_geotiff(nz: int, ny: int, nx: int, step_m: float, latitude: float, longitude: float) -> None:
    import tempfile

    rng = np.random.default_rng(nz + ny + nx)
    dataset = make_map(
        rng.normal(size=(nz, ny, nx)).astype(np.float32),
        x_m=np.arange(nx) * step_m,
        y_m=np.arange(ny) * step_m - 500,
        z_m=np.arange(nz) * 10.0 + 20,
        source="test",
        anchor=Anchor(latitude, longitude),
    )
    with tempfile.TemporaryDirectory() as folder:
        save_map(dataset, Path(folder) / "map.tif")
        back = load_map(Path(folder) / "map.tif")
    np.testing.assert_array_equal(back["sinr_db"].values, dataset["sinr_db"].values)
    np.testing.assert_array_equal(back["x"].values, dataset["x"].values)
