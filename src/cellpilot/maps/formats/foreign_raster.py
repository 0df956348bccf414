"""A raster of any coordinate system on a grid of local metres, each cell taking the pixel that its centre lies in."""

from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor, to_degrees, to_local

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

WGS84 = "EPSG:4326"

FloatArray = NDArray[np.float64]


class LocalGrid(NamedTuple):
    """Cell centres [m] around an anchor, and for each cell [y, x] the pixel that its centre lies in."""

    anchor: Anchor
    x_m: FloatArray
    y_m: FloatArray
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    inside: NDArray[np.bool_]

    def sample(self, values: FloatArray) -> FloatArray:
        """Values of the cells [z, y, x] from those of the pixels [z, row, column]; NaN beyond the raster."""
        return np.where(self.inside, values[:, self.row, self.column], np.nan)


def local_grid(file: "DatasetReader") -> LocalGrid:
    """Cells of the size of a pixel in either direction around the middle of an opened raster.

    Columns and rows that run east and north become columns and rows of cells, pixel by pixel; so do all in degrees. A raster
    that is turned is covered by cells, and those beyond it are marked as not `inside`. `InputError` where the coordinate
    system has no way to degrees.
    """
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        to_wgs84 = Transformer.from_crs(file.crs.to_wkt(), WGS84, always_xy=True)
        middle_x, middle_y = apply(file.transform, file.width / 2, file.height / 2)
        longitude_deg, latitude_deg = to_wgs84.transform(middle_x, middle_y)
        # Rasters that cross the antimeridian go on beyond 180 degrees.
        anchor = Anchor(latitude_deg, (longitude_deg + 180) % 360 - 180)
        x_m, y_m = _centres(file, to_wgs84, anchor)
        latitude, longitude = to_degrees(*np.meshgrid(x_m, y_m), anchor)
        place_x, place_y = to_wgs84.transform(longitude, latitude, direction="INVERSE")
    except ProjError as error:
        raise InputError(
            f"the coordinate system has no way to WGS84 degrees ({' '.join(str(error).split())[:120]});"
            " assign the right one (gdal_edit.py -a_srs EPSG:... FILE)"
        ) from None
    if file.crs.is_geographic:
        place_x = place_x + 360 * np.round((middle_x - place_x) / 360)
    column, row = apply(~file.transform, place_x, place_y)
    inside = (column >= 0) & (column < file.width) & (row >= 0) & (row < file.height)
    column, row = (np.where(inside, index, 0).astype(np.int64) for index in (column, row))
    return LocalGrid(anchor, x_m, y_m, row, column, inside)


def apply(transform: Any, column: Any, row: Any) -> tuple[Any, Any]:
    """Coordinates of places in a raster [columns, rows], or with the inverse transform the other way round."""
    a, b, c, d, e, f = transform[:6]
    return a * column + b * row + c, d * column + e * row + f


def _centres(file: "DatasetReader", to_wgs84: Any, anchor: Anchor) -> tuple[FloatArray, FloatArray]:
    """Centres of cells as wide and as high as a pixel, so many that they cover the raster."""

    def local(column: Any, row: Any) -> tuple[FloatArray, FloatArray]:
        longitude_deg, latitude_deg = to_wgs84.transform(*apply(file.transform, column, row))
        return to_local(latitude_deg, longitude_deg, anchor)

    width, height = file.width, file.height
    columns, rows = np.arange(width + 1.0), np.arange(height + 1.0)
    edges = [
        local(columns, 0 * columns),
        local(columns, 0 * columns + height),
        local(0 * rows, rows),
        local(0 * rows + width, rows),
    ]
    x_m, y_m = (np.concatenate(axis) for axis in zip(*edges, strict=True))
    if not (np.isfinite(x_m).all() and np.isfinite(y_m).all()):
        raise InputError("parts of the raster lie nowhere on Earth; expected another coordinate system, or a part of it")
    middles = (np.array([0.0, width]), np.full(2, height / 2)), (np.full(2, width / 2), np.array([0.0, height]))
    (across_m, n_across), (down_m, n_down) = (
        (np.ptp(np.stack(local(*line)), axis=1), n) for line, n in zip(middles, (width, height), strict=True)
    )
    if across_m[0] < across_m[1]:  # columns run rather north than east
        (across_m, n_across), (down_m, n_down) = (down_m, n_down), (across_m, n_across)
    return _axis(x_m, np.hypot(*across_m) / n_across, n_across), _axis(y_m, np.hypot(*down_m) / n_down, n_down)


def _axis(edges_m: FloatArray, step_m: float, n_pixels: int) -> FloatArray:
    """Centres around 0 that cover the edges but for a quarter of a cell; pixel centres stay cell centres (odd or even)."""
    beyond = np.ptp(edges_m) / step_m - n_pixels
    n = n_pixels + 2 * max(0, int(np.ceil(beyond / 2 - 0.25)))
    return (np.arange(n) - (n - 1) / 2) * step_m
