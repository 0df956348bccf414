"""GeoTIFF from elsewhere: every pixel where it belongs, in the unit and at the height that the file says."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rasterio
from pyproj import Transformer

from cellpilot.errors import InputError
from cellpilot.maps import RadioMap, anchor_of, load_map, to_degrees, to_local
from cellpilot.maps.reasons import blocked_cells

PIXELS = np.arange(200, dtype=np.float32).reshape(1, 10, 20)
UTM = "EPSG:32629"
NORTH_UP = rasterio.Affine(30, 0, 499_700, 0, -20, 5_750_000)
"""Around the central meridian of its zone, where columns run north."""


def write_raster(
    path: Path, bands: np.ndarray, crs: str | None, transform: rasterio.Affine, heights: tuple[str, ...] = ("30",), **profile: Any
) -> None:
    """A raster as another program makes it, which states heights for as many bands as there are `heights`."""
    shape = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2], "dtype": bands.dtype}
    with rasterio.open(path, "w", driver="GTiff", crs=crs, transform=transform, **shape, **profile) as file:
        file.write(bands)
        for band, height in enumerate(heights, 1):
            file.update_tags(band, HEIGHT_M=height)


def local(dataset: RadioMap, transform: rasterio.Affine, crs: str) -> tuple[np.ndarray, np.ndarray]:
    """The middles of the pixels in a map's local metres, by another library."""
    columns, rows = np.meshgrid(np.arange(20) + 0.5, np.arange(10) + 0.5)
    a, b, c, d, e, f = transform[:6]
    place = a * columns + b * rows + c, d * columns + e * rows + f
    longitude, latitude = Transformer.from_crs(crs, "EPSG:4326", always_xy=True).transform(*place)
    anchor = anchor_of(dataset)
    assert anchor is not None
    return to_local(latitude, longitude, anchor)


@pytest.mark.parametrize(
    ("crs", "transform", "step_m", "off"),
    [
        (UTM, NORTH_UP, (30.0, 20.0), 0.002),
        (UTM, rasterio.Affine(30, 0, 540_000, 0, -30, 5_750_000), (30.0, 30.0), 0.1),
        ("EPSG:3857", rasterio.Affine(30, 0, -935_000, 0, -30, 6_780_000), (18.6, 18.6), 0.002),
        # Degrees of two datums, and grads from Paris.
        ("EPSG:4326", rasterio.Affine(2e-4, 0, 7.0, 0, -2e-4, 50.0), (14.34, 22.24), 1e-6),
        ("EPSG:4277", rasterio.Affine(2e-4, 0, -1.0, 0, -2e-4, 52.0), (13.73, 22.25), 1e-3),
        ("EPSG:4807", rasterio.Affine(2e-4, 0, 1.0, 0, -2e-4, 54.0), (13.26, 20.01), 1e-3),
        # From south to north, from east to west, and across the antimeridian.
        ("EPSG:4326", rasterio.Affine(2e-4, 0, 7.0, 0, 2e-4, 50.0), (14.34, 22.24), 1e-6),
        ("EPSG:4326", rasterio.Affine(-2e-4, 0, 7.0, 0, -2e-4, 50.0), (14.34, 22.24), 1e-6),
        ("EPSG:4326", rasterio.Affine(2e-4, 0, 179.9975, 0, -2e-4, 50.0), (14.34, 22.24), 1e-6),
        ("EPSG:4326", rasterio.Affine(2e-4, 0, 190.0, 0, -2e-4, 50.0), (14.34, 22.24), 1e-6),
    ],
)
def test_every_pixel_becomes_a_cell(
    tmp_path: Path, crs: str, transform: rasterio.Affine, step_m: tuple[float, float], off: float
) -> None:
    values = PIXELS.copy()
    values[0, 3, 4] = -9999
    write_raster(tmp_path / "a.tif", values, crs, transform, nodata=-9999)
    dataset = load_map(tmp_path / "a.tif")
    assert dict(dataset.sizes) == {"z": 1, "y": 10, "x": 20}
    assert dataset["z"].values.tolist() == [30.0]
    assert [np.diff(dataset[axis].values)[0] for axis in "xy"] == pytest.approx(step_m, rel=0.005)
    values[0, 3, 4] = np.nan
    upwards = values[0, :: 1 if transform.e > 0 else -1, :: 1 if transform.a > 0 else -1]
    np.testing.assert_array_equal(dataset["sinr_db"].values[0], upwards)
    x_m, y_m = local(dataset, transform, crs)
    assert np.abs(np.sort(x_m) - dataset["x"].values).max() <= off * step_m[0]
    assert np.abs(np.sort(y_m, axis=0) - dataset["y"].values[:, None]).max() <= off * step_m[1]


def test_eight_thousand_pixels_in_degrees_survive(tmp_path: Path) -> None:
    pixels = (np.arange(8000, dtype=np.float32) / 100).reshape(1, 80, 100)
    write_raster(tmp_path / "a.tif", pixels, "EPSG:4326", rasterio.Affine(2e-4, 0, 7, 0, -2e-4, 50))
    np.testing.assert_array_equal(load_map(tmp_path / "a.tif")["sinr_db"].values, pixels[:, ::-1])


@pytest.mark.parametrize("angle_deg", [30.0, 90.0, 200.0])
def test_a_cell_of_a_turned_raster_has_the_pixel_of_its_centre(tmp_path: Path, angle_deg: float) -> None:
    cosine, sine = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    transform = rasterio.Affine(30 * cosine, 20 * sine, 500_000, 30 * sine, -20 * cosine, 5_750_000)
    write_raster(tmp_path / "a.tif", PIXELS, UTM, transform)
    dataset = load_map(tmp_path / "a.tif")
    anchor = anchor_of(dataset)
    assert anchor is not None
    latitude, longitude = to_degrees(*np.meshgrid(dataset["x"], dataset["y"]), anchor)
    east, north = Transformer.from_crs("EPSG:4326", UTM, always_xy=True).transform(longitude, latitude)
    # Along the turned axes, in pixels.
    column = np.floor(((east - 500_000) * cosine + (north - 5_750_000) * sine) / 30).astype(int)
    row = np.floor(((east - 500_000) * sine - (north - 5_750_000) * cosine) / 20).astype(int)
    inside = (column >= 0) & (column < 20) & (row >= 0) & (row < 10)
    expected = np.where(inside, PIXELS[0, np.clip(row, 0, 9), np.clip(column, 0, 19)], np.nan)
    np.testing.assert_array_equal(dataset["sinr_db"].values[0], expected)
    np.testing.assert_array_equal(blocked_cells(dataset)[0], ~inside)
    assert inside[:, 1:-1].any(axis=0).all()  # no margin of empty cells, but for what keeps an even number even
    assert inside[1:-1].any(axis=1).all()
    assert np.isin(PIXELS, expected).mean() >= (1.0 if angle_deg == 90 else 0.7)
    if angle_deg == 90:
        assert dict(dataset.sizes) == {"z": 1, "y": 20, "x": 10}


def test_beyond_a_raster_nothing_is_free(tmp_path: Path) -> None:
    pixels = np.where(PIXELS == 105, np.float32(np.nan), PIXELS)
    write_raster(tmp_path / "a.tif", pixels, UTM, rasterio.Affine(20, 20, 500_000, 20, -20, 5_750_000))
    attributes = {"anchor_latitude_deg": 50, "anchor_longitude_deg": 7, "unknown": "bad", "source": "test"}
    with rasterio.open(tmp_path / "a.tif", "r+") as file:  # as a warped map of ours has it
        file.update_tags(CELLPILOT=json.dumps({"x": [0, 1], "y": [0, 1], "variables": ["sinr_db"], "attrs": attributes}))
    dataset = load_map(tmp_path / "a.tif")
    assert dataset.attrs["unknown"] == "bad"
    blocked, unknown = blocked_cells(dataset)[0], np.isnan(dataset["sinr_db"].values[0])
    assert blocked[[0, 0, -1, -1], [0, -1, 0, -1]].all()
    assert (unknown & ~blocked).any()  # the hole, in the middle
    assert (unknown & ~blocked).sum() < 5


def test_whole_numbers_with_scale_offset_and_nodata(tmp_path: Path) -> None:
    counts = np.array([[[100, -32768], [-50, 0]]], np.int16)
    write_raster(tmp_path / "a.tif", counts, UTM, NORTH_UP, nodata=-32768)
    np.testing.assert_array_equal(load_map(tmp_path / "a.tif")["sinr_db"].values, [[[-50, 0], [100, np.nan]]])
    with rasterio.open(tmp_path / "a.tif", "r+") as file:
        file.scales, file.offsets = (0.1,), (-3.0,)
    expected = np.array([[[-8, -3], [7, np.nan]]], np.float32)
    np.testing.assert_array_equal(load_map(tmp_path / "a.tif")["sinr_db"].values, expected)
    write_raster(tmp_path / "a.tif", counts.astype(np.complex64), UTM, NORTH_UP)
    with pytest.raises(InputError, match=r"a\.tif: the bands are of type complex64; expected real numbers"):
        load_map(tmp_path / "a.tif")


def test_heights(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    two = np.concatenate([PIXELS, PIXELS + 1])
    write_raster(path, two, UTM, NORTH_UP, ())
    with pytest.raises(InputError, match=r"a\.tif: 2 band\(s\) without a height; give one for each: `heights_m`"):
        load_map(path)
    with pytest.raises(InputError, match=r"a\.tif: 2 band\(s\), and 1 height\(s\) given"):
        load_map(path, heights_m=(30.0,))
    with pytest.raises(InputError, match=r"a\.tif: bands at 30, 30 m; expected each height once"):
        load_map(path, heights_m=(30.0, 30.0))
    downwards = load_map(path, heights_m=(50.0, 30.0))
    assert downwards["z"].values.tolist() == [30.0, 50.0]
    np.testing.assert_array_equal(downwards["sinr_db"].values, two[::-1, ::-1])
    for text in ("thirty", "nan"):
        write_raster(path, two, UTM, NORTH_UP, (text, "50"))
        with pytest.raises(InputError, match=rf"a\.tif: 1 band\(s\) without a height \(band 1: '{text}'\)"):
            load_map(path)
    assert load_map(path, heights_m=(30.0, 50.0))["z"].values.tolist() == [30.0, 50.0]
    with pytest.raises(InputError, match=r"a\.tif: band 2 states a height of 50 m, and 60 m is given; leave `heights_m` out"):
        load_map(path, heights_m=(30.0, 60.0))


def test_rasters_that_lie_nowhere(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        write_raster(path, PIXELS, None, rasterio.Affine.identity())
    with pytest.raises(InputError, match=r"a\.tif: no coordinate system"):
        load_map(path)
    with pytest.warns(rasterio.errors.NotGeoreferencedWarning):
        write_raster(path, PIXELS, UTM, rasterio.Affine.identity())
    with pytest.raises(InputError, match=r"a\.tif: no corners and pixel size"):
        load_map(path)
    write_raster(path, PIXELS, "EPSG:4326", rasterio.Affine(0.1, 0, 0, 0, -0.1, 90))
    with pytest.raises(InputError, match=r"a\.tif: the anchor's latitude is 89.5"):
        load_map(path)
    write_raster(path, PIXELS, 'LOCAL_CS["site",UNIT["metre",1]]', rasterio.Affine(30, 0, 0, 0, -30, 0))
    with pytest.raises(InputError, match=r"a\.tif: the coordinate system has no way to WGS84 degrees"):
        load_map(path)
    write_raster(path, PIXELS, UTM, rasterio.Affine(1e9, 0, 0, 0, -1e9, 5e8))
    with pytest.raises(InputError, match=r"a\.tif: "):
        load_map(path)
    write_raster(path, PIXELS[:, :1, :1], UTM, NORTH_UP)
    with pytest.raises(InputError, match=r"a\.tif: the map has 1 cell"):
        load_map(path)
    path.write_text("not a picture")
    with pytest.raises(InputError, match=r"a\.tif: not a readable GeoTIFF"):
        load_map(path)


def test_a_tag_that_is_no_tag(tmp_path: Path) -> None:
    for text in (
        "{",
        "[]",
        '{"x": [1, "a"], "y": [], "attrs": {}, "variables": []}',
        '{"x": [], "y": [], "attrs": 3, "variables": 1}',
    ):
        write_raster(tmp_path / "a.tif", PIXELS, UTM, NORTH_UP)
        with rasterio.open(tmp_path / "a.tif", "r+") as file:
            file.update_tags(CELLPILOT=text)
        with pytest.raises(InputError, match=r"a\.tif: the tag CELLPILOT.*-unsetmd CELLPILOT"):
            load_map(tmp_path / "a.tif")
