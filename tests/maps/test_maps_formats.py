"""Files of maps: what each format keeps, what other programs read in them, and what is refused."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
import rasterio
import xarray as xr
from pyproj import Geod

from cellpilot.errors import InputError
from cellpilot.maps import Anchor, RadioMap, anchor_of, load_map, make_map, save_map, simulate_map, to_degrees, to_local
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_MEASUREMENT
from cellpilot.radio import hexagonal_deployment

ANCHOR = Anchor(51.9, -8.4)


@pytest.fixture
def anchored() -> RadioMap:
    """Two heights of 3 x 4 cells of 20 x 25 m with holes, and something to say in every variable over cells."""
    rng = np.random.default_rng(0)
    sinr_db = rng.normal(0, 8, (2, 3, 4)).astype(np.float32)
    sinr_db[:, 1, 2] = np.nan
    blocked_reason = np.where(np.isnan(sinr_db), 1, 0)
    blocked_reason[1, 0, 0] = 2
    return make_map(
        sinr_db,
        x_m=np.arange(4) * 20.0 - 30,
        y_m=np.arange(3) * 25.0 + 100,
        z_m=[30.0, 47.5],
        source="test",
        sinr_std_db=np.where(np.isnan(sinr_db), np.nan, 0.5).astype(np.float32),
        count=rng.integers(0, 9, (2, 3, 4)),
        filled=rng.random((2, 3, 4)) < 0.3,
        blocked_reason=blocked_reason,
        reasons=(NO_MEASUREMENT, INSIDE_BUILDING),
        optional={"sinr_spread_db": np.abs(sinr_db), "serving_sector": rng.integers(-1, 3, (2, 3, 4))},
        anchor=ANCHOR,
        licence="CC0",
        attributes={"bin_m": 20.0},
    )


def copied(source: Path, path: Path, rows: slice, columns: slice, move_deg: float = 0.0) -> Path:
    """Some of a raster, with all of its tags: what GDAL and QGIS make of it."""
    with rasterio.open(source) as file:
        bands = file.read()[:, rows, columns]
        step_x, _, west, _, step_y, north = file.transform[:6]
        west, north = west + step_x * (columns.start or 0) + move_deg, north + step_y * (rows.start or 0)
        transform = rasterio.Affine(step_x * (columns.step or 1), 0, west, 0, step_y * (rows.step or 1), north)
        shape = {"height": bands.shape[1], "width": bands.shape[2], "transform": transform}
        with rasterio.open(path, "w", **{**file.profile, **shape}) as copy:
            copy.write(bands)
            copy.update_tags(**file.tags())
            for band in range(1, file.count + 1):
                copy.update_tags(band, **file.tags(band))
    return path


def off_m(longitude: float, latitude: float, x_m: float, y_m: float) -> float:
    """From a place in degrees to one in local metres [m], by another library."""
    expected_latitude, expected_longitude = to_degrees(x_m, y_m, ANCHOR)
    return float(Geod(ellps="WGS84").inv(longitude, latitude, float(expected_longitude), float(expected_latitude))[2])


@pytest.mark.parametrize("suffix", [".nc", ".zarr"])
def test_netcdf_and_zarr_keep_everything(anchored: RadioMap, tmp_path: Path, suffix: str) -> None:
    simulated = simulate_map(hexagonal_deployment(), x_range_m=(0.0, 60.0), y_range_m=(0.0, 40.0), points_per_side=2)
    for number, dataset in enumerate((anchored, simulated)):
        save_map(dataset, tmp_path / f"{number}{suffix}")
        save_map(dataset, tmp_path / f"{number}{suffix}")  # and once more over it
        xr.testing.assert_identical(load_map(tmp_path / f"{number}{suffix}"), dataset)


def test_csv_names_places_in_degrees(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.csv")
    lines = (tmp_path / "map.csv").read_text().splitlines()
    assert len(lines) == 2 + 24
    first = dict(zip(lines[1].split(","), lines[2].split(","), strict=True))
    latitude, longitude = to_degrees(-30.0, 100.0, ANCHOR)
    assert float(first["latitude"]) == float(latitude)
    assert float(first["longitude"]) == float(longitude)


def test_geotiff_comes_back_equal(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    xr.testing.assert_identical(load_map(tmp_path / "map.tif"), anchored)
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.dtypes[0] == "float32"
        assert file.descriptions[:2] == ("sinr_db at 30 m", "sinr_db at 47.5 m")
        assert "blocked_reason at 30 m" in file.descriptions
        assert [file.tags(band)["VARIABLE"] for band in (1, 2)] == ["sinr_db"] * 2
    plain = anchored.assign(sinr_db=anchored["sinr_db"].fillna(1.0))[["sinr_db"]]
    plain = make_map(plain["sinr_db"], x_m=plain["x"], y_m=plain["y"], z_m=plain["z"], source="test", anchor=ANCHOR)
    save_map(plain, tmp_path / "plain.tif")
    with rasterio.open(tmp_path / "plain.tif") as file:
        assert file.count == 2
    xr.testing.assert_identical(load_map(tmp_path / "plain.tif"), plain)


def test_geotiff_of_one_variable(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "count.tif", variable="count")
    with rasterio.open(tmp_path / "count.tif") as file:
        np.testing.assert_array_equal(file.read(), anchored["count"].values[:, ::-1])
    with pytest.raises(InputError, match=r"count\.tif: holds count, not SINR"):
        load_map(tmp_path / "count.tif")
    many = anchored.assign(count=anchored["count"] + 2**24)
    save_map(many, tmp_path / "many.tif")
    np.testing.assert_array_equal(load_map(tmp_path / "many.tif")["count"], many["count"])


def test_geotiff_lies_where_the_map_lies(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    with rasterio.open(tmp_path / "map.tif") as file:
        assert file.crs == "EPSG:4326"
        assert file.units[:2] == ("dB", "dB")
        assert np.isnan(file.nodata)
        corners = {(0, 0): (-40.0, 162.5), (4, 3): (40.0, 87.5)}  # column, row of the raster: x, y of the outer corner
        for (column, row), (x_m, y_m) in corners.items():
            assert off_m(*file.xy(row, column, offset="ul"), x_m, y_m) < 1e-3
        np.testing.assert_array_equal(file.read(1)[0], anchored["sinr_db"].values[0, -1])


@pytest.mark.skipif(
    shutil.which("gdalinfo") is None and not os.environ.get("CI"), reason="gdalinfo (Debian: gdal-bin) is not installed"
)
def test_gdalinfo_reads_corners_and_values(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    told = subprocess.run(["gdalinfo", "-json", "-stats", "map.tif"], cwd=tmp_path, capture_output=True, text=True, check=True)
    about = json.loads(told.stdout)
    corners = {"upperLeft": (-40, 162.5), "upperRight": (40, 162.5), "lowerLeft": (-40, 87.5), "lowerRight": (40, 87.5)}
    for name, (x_m, y_m) in corners.items():
        assert off_m(*about["cornerCoordinates"][name], x_m, y_m) < 1.0, name
    for iz, band in enumerate(about["bands"][:2]):
        assert band["unit"] == "dB"
        assert band["description"].startswith("sinr_db")
        assert band["mean"] == pytest.approx(float(np.nanmean(anchored["sinr_db"].values[iz].astype(float))), abs=1e-3)


def test_what_was_cropped_or_resampled_lies_where_it_was_put(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    for number, (rows, columns) in enumerate(((slice(0, 2), slice(1, 4)), (slice(None, None, 2), slice(None, None, 2)))):
        crop = load_map(copied(tmp_path / "map.tif", tmp_path / f"{number}.tif", rows, columns))
        for name in anchored.data_vars:  # rasters begin in the north, maps in the south
            expected = anchored[name].values[:, ::-1][:, rows, columns][:, ::-1]
            np.testing.assert_array_equal(crop[name].values, expected, err_msg=str(name))
        anchor = anchor_of(crop)
        assert anchor is not None
        if number == 0:
            latitude, longitude = to_degrees(crop["x"].values[[0, -1]], crop["y"].values[[0, -1]], anchor)
            np.testing.assert_allclose(to_local(latitude, longitude, ANCHOR), [[-10, 30], [125, 150]], atol=1e-6)
        assert (crop.attrs["source"], crop.attrs["licence"]) == ("test", "CC0")
        assert "bin_m" not in crop.attrs


@pytest.mark.parametrize(("move_m", "moved"), [(0.0, False), (0.0005, False), (0.01, True), (1000.0, True)])
def test_the_tag_is_believed_to_a_millimetre(anchored: RadioMap, tmp_path: Path, move_m: float, moved: bool) -> None:
    save_map(anchored, tmp_path / "map.tif")
    degrees = float(to_degrees(0.0, 0.0, ANCHOR)[1] - to_degrees(-move_m, 0.0, ANCHOR)[1])
    found = load_map(copied(tmp_path / "map.tif", tmp_path / "moved.tif", slice(None), slice(None), degrees))
    assert (anchor_of(found) != ANCHOR) == moved
    anchor = anchor_of(found)
    assert anchor is not None
    latitude, longitude = to_degrees(found["x"].values[0], found["y"].values[0], anchor)
    assert to_local(latitude, longitude, ANCHOR)[0] == pytest.approx(-30 + move_m, abs=0.001)


def test_what_forbids_cells_does_not_get_lost(anchored: RadioMap, tmp_path: Path) -> None:
    save_map(anchored, tmp_path / "map.tif")
    with (
        rasterio.open(tmp_path / "map.tif") as file,
        rasterio.open(tmp_path / "two.tif", "w", **file.profile | {"count": 2}) as two,
    ):
        two.write(file.read([1, 2]))
        two.update_tags(**file.tags())
        for band, height_m in ((1, "30"), (2, "47.5")):
            two.update_tags(band, HEIGHT_M=height_m)
    with pytest.raises(InputError, match=r"two\.tif: the bands of sinr_std_db, count, filled, blocked_reason are missing"):
        load_map(tmp_path / "two.tif")
    with rasterio.open(tmp_path / "map.tif") as file, rasterio.open(tmp_path / "copy.tif", "w", **file.profile) as copy:
        copy.write(file.read())
        copy.update_tags(**file.tags())
        for band in range(1, file.count + 1):
            copy.update_tags(band, **file.tags(band))
    with rasterio.open(tmp_path / "copy.tif", "r+") as file:
        bands = [band for band in range(1, file.count + 1) if file.tags(band)["VARIABLE"] == "blocked_reason"]
        file.write(np.full((2, 3, 4), 0.25, np.float32), bands)
    with pytest.raises(InputError, match=r"copy\.tif: blocked_reason in fractions: the raster was averaged"):
        load_map(tmp_path / "copy.tif")


def test_maps_that_are_no_raster(tmp_path: Path) -> None:
    axes = {"x_m": [0.0], "y_m": [0.0, 25.0], "z_m": [30.0, 50.0], "source": "test", "anchor": ANCHOR}
    column = make_map(np.arange(4.0).reshape(2, 2, 1), **axes)
    save_map(column, tmp_path / "column.tif")
    xr.testing.assert_identical(load_map(tmp_path / "column.tif"), column)
    with rasterio.open(tmp_path / "column.tif") as file:
        west, east = (to_local(ANCHOR.latitude_deg, degrees, ANCHOR)[0] for degrees in (file.bounds.left, file.bounds.right))
    assert [west, east] == pytest.approx([-12.5, 12.5])
    with pytest.raises(InputError, match=r"single\.tif: one column and one row of cells"):
        save_map(make_map(np.ones((2, 1, 1)), **axes | {"y_m": [0.0]}), tmp_path / "single.tif")
    simulated = simulate_map(
        hexagonal_deployment(), x_range_m=(0.0, 60.0), y_range_m=(0.0, 40.0), points_per_side=2, anchor=ANCHOR
    )
    with pytest.raises(InputError, match=r"a\.tif: rsrp_dbm belongs to sectors"):
        save_map(simulated, tmp_path / "a.tif", variable="rsrp_dbm")
    for name in ("x", "sector_name", "nonsense"):
        with pytest.raises(InputError, match=rf"a\.tif: the map has no {name}"):
            save_map(simulated, tmp_path / "a.tif", variable=name)
