"""GeoTIFF: one variable of a map, one band for each height (extra `geo`).

A map's local metres are degrees times two constants (see `geodesy`), so a map is written in WGS84 degrees (EPSG:4326)
without resampling, and comes back equal. A raster in any other coordinate system is read onto a local grid of its own pixel
size, each cell taking the value of the pixel that its centre lies in.
"""

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor, metres_per_degree, to_degrees, to_local
from cellpilot.maps.schema import FIELDS, RadioMap, anchor_of, make_map
from cellpilot.provenance import write_atomically

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

WGS84 = "EPSG:4326"
TAG = "CELLPILOT"
"""Tag that holds the map's attributes and local coordinates as JSON."""

FloatArray = NDArray[np.float64]


def write(dataset: RadioMap, path: Path, variable: str = "sinr_db") -> None:
    """Write one variable over cells of a map that has an anchor; unknown is NaN, which is also the nodata value.

    `InputError` for a map without an anchor, a variable it does not have, or heights and places that are no raster.
    """
    rasterio = _rasterio()
    anchor = anchor_of(dataset)
    if anchor is None:
        raise InputError(f"{path}: the map lies nowhere on Earth; give it an anchor (latitude and longitude of x = y = 0)")
    if variable not in dataset:
        raise InputError(f"{path}: the map has no {variable}; it has {', '.join(map(str, dataset.data_vars))}")
    x_m, y_m, z_m = (dataset[axis].values for axis in "xyz")
    bands = dataset[variable].values[:, ::-1].astype(np.float32)  # rasters begin in the north-west
    per_longitude_m, per_latitude_m = metres_per_degree(anchor.latitude_deg)
    step_x_deg, step_y_deg = _step(x_m, y_m) / per_longitude_m, _step(y_m, x_m) / per_latitude_m
    north_deg, west_deg = to_degrees(x_m[0], y_m[-1], anchor)
    transform = rasterio.Affine(
        step_x_deg, 0, float(west_deg) - step_x_deg / 2, 0, -step_y_deg, float(north_deg) + step_y_deg / 2
    )
    profile = {
        "driver": "GTiff",
        "width": len(x_m),
        "height": len(y_m),
        "count": len(z_m),
        "dtype": "float32",
        "crs": WGS84,
        "transform": transform,
        "nodata": float("nan"),
        "compress": "deflate",
    }
    about = {"x": x_m.tolist(), "y": y_m.tolist(), "variable": variable, "attrs": dataset.attrs}
    field = FIELDS[variable]

    def fill(temporary: Path) -> None:
        with rasterio.open(temporary, "w", **profile) as file:
            file.update_tags(**{TAG: json.dumps(about, sort_keys=True)})
            for band, height_m in enumerate(z_m.tolist(), 1):
                file.write(bands[band - 1], band)
                file.set_band_description(band, f"{variable} at {height_m:g} m")
                file.update_tags(band, HEIGHT_M=repr(height_m))
                file.set_band_unit(band, field.units)

    write_atomically(path, fill)


def read(path: Path, heights_m: tuple[float, ...] | None = None) -> RadioMap:
    """The map in a GeoTIFF of SINR [dB].

    `heights_m` gives the height of each band where the file does not say. `InputError` for a file without a coordinate
    system, with bands whose heights nobody states, or that is no raster.
    """
    rasterio = _rasterio()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # it is refused below, in words
            opened = rasterio.open(path)
        with opened as file:
            bands = file.read(masked=True).filled(np.nan).astype(np.float32)
            if file.crs is None:
                raise InputError(
                    f"{path}: no coordinate system; expected a georeferenced GeoTIFF:"
                    " assign one (gdal_edit.py -a_srs EPSG:... FILE)"
                )
            heights_m = _heights(path, file, heights_m)
            about = file.tags().get(TAG)
            if about is not None:
                return _own(path, json.loads(about), bands, heights_m)
            return _foreign(file, bands, heights_m)
    except rasterio.errors.RasterioIOError as error:
        raise InputError(f"{path}: not a readable GeoTIFF ({' '.join(str(error).split())[:120]})") from None


def _rasterio() -> Any:
    try:
        import rasterio
        import rasterio.errors
    except ImportError:
        raise InputError("GeoTIFF files need the package rasterio: pip install 'cellpilot[geo]'") from None
    return rasterio


def _step(centres_m: FloatArray, others_m: FloatArray) -> float:
    """Side of a cell [m]; that of the other axis where there is one row only."""
    along = centres_m if len(centres_m) > 1 else others_m
    return float((along[-1] - along[0]) / (len(along) - 1))


def _heights(path: Path, file: "DatasetReader", given_m: tuple[float, ...] | None) -> tuple[float, ...]:
    stated = [file.tags(band).get("HEIGHT_M") for band in range(1, file.count + 1)]
    if given_m is None and None not in stated:
        return tuple(float(height) for height in stated)
    if given_m is None:
        raise InputError(f"{path}: {file.count} band(s) without a height; give one for each: --heights-m 30 50 ...")
    if len(given_m) != file.count:
        raise InputError(f"{path}: {file.count} band(s), and {len(given_m)} height(s) given; expected one for each band")
    return given_m


def _own(path: Path, about: dict[str, Any], bands: NDArray[np.float32], heights_m: tuple[float, ...]) -> RadioMap:
    if about["variable"] != "sinr_db":
        raise InputError(f"{path}: holds {about['variable']}, not SINR; a map needs sinr_db")
    dataset = make_map(
        bands[:, ::-1],
        x_m=about["x"],
        y_m=about["y"],
        z_m=heights_m,
        source="GeoTIFF",
        unknown=about["attrs"].get("unknown", "blocked"),
    )
    dataset.attrs = about["attrs"]
    return dataset


def _foreign(file: "DatasetReader", bands: NDArray[np.float32], heights_m: tuple[float, ...]) -> RadioMap:
    """A raster of any coordinate system on a local grid of square cells, the area of one as large as that of a pixel."""
    from pyproj import Transformer

    to_wgs84 = Transformer.from_crs(file.crs, WGS84, always_xy=True)
    longitude_deg, latitude_deg = to_wgs84.transform(*_apply(file.transform, file.width / 2, file.height / 2))
    anchor = Anchor(latitude_deg, longitude_deg)
    columns, rows = np.meshgrid(np.arange(file.width + 1.0), np.arange(file.height + 1.0))
    corner_longitude, corner_latitude = to_wgs84.transform(*_apply(file.transform, columns, rows))
    x_m, y_m = to_local(corner_latitude, corner_longitude, anchor)
    iy, ix = file.height // 2, file.width // 2
    side_m = float(np.sqrt(abs(_area(x_m[iy : iy + 2, ix : ix + 2], y_m[iy : iy + 2, ix : ix + 2]))))
    x_centres, y_centres = (_centres(values, side_m) for values in (x_m, y_m))
    latitude, longitude = to_degrees(*np.meshgrid(x_centres, y_centres), anchor)
    place = Transformer.from_crs(WGS84, file.crs, always_xy=True).transform(longitude, latitude)
    column, row = _apply(~file.transform, *place)
    inside = (column >= 0) & (column < file.width) & (row >= 0) & (row < file.height)
    column, row = (np.where(inside, index, 0).astype(np.int64) for index in (column, row))
    values = np.where(inside, bands[:, row, column], np.nan)
    return make_map(
        values, x_m=x_centres, y_m=y_centres, z_m=heights_m, source="GeoTIFF", anchor=anchor, model=f"raster in {file.crs}"
    )


def _apply(transform: Any, column: Any, row: Any) -> tuple[Any, Any]:
    """Coordinates of places in a raster [columns, rows], or with the inverse transform the other way round."""
    a, b, c, d, e, f = transform[:6]
    return a * column + b * row + c, d * column + e * row + f


def _area(x_m: FloatArray, y_m: FloatArray) -> float:
    """Of a quadrangle given by its four corners in two rows [m^2]."""
    across, down = (x_m[1, 1] - x_m[0, 0], y_m[1, 1] - y_m[0, 0]), (x_m[1, 0] - x_m[0, 1], y_m[1, 0] - y_m[0, 1])
    return 0.5 * float(across[0] * down[1] - across[1] * down[0])


def _centres(values_m: FloatArray, side_m: float) -> FloatArray:
    n = max(1, round(np.ptp(values_m) / side_m))
    return np.asarray(values_m.min() + (np.arange(n) + 0.5) * np.ptp(values_m) / n)
