"""A raster of any coordinate system on a grid of local metres, each cell taking the pixel that its centre lies in."""

from math import ceil
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor, to_degrees, to_local

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

WGS84 = "EPSG:4326"


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

    def local(column: Any, row: Any) -> FloatArray:
        longitude_deg, latitude_deg = to_wgs84.transform(*apply(file.transform, column, row))
        return np.stack(to_local(latitude_deg, longitude_deg, anchor))

    width, height = file.width, file.height
    columns, rows = np.arange(width + 1.0), np.arange(height + 1.0)
    edges = (
        local(columns, 0 * columns),
        local(columns, 0 * columns + height),
        local(0 * rows, rows),
        local(0 * rows + width, rows),
    )
    x_m, y_m = np.concatenate(edges, axis=1)
    if not (np.isfinite(x_m).all() and np.isfinite(y_m).all()):
        raise InputError("parts of the raster lie nowhere on Earth; expected another coordinate system, or a part of it")
    across_m = local(width, height / 2) - local(0, height / 2)
    down_m = local(width / 2, height) - local(width / 2, 0)
    along_x, along_y = (float(np.hypot(*across_m)), width), (float(np.hypot(*down_m)), height)
    if abs(across_m[0]) < abs(across_m[1]):  # columns run rather north than east
        along_x, along_y = along_y, along_x
    return _axis(x_m, *along_x), _axis(y_m, *along_y)


def _axis(edges_m: FloatArray, length_m: float, n_pixels: int) -> FloatArray:
    """Centres around 0 that cover the edges but for a quarter of a cell; odd stays odd, so that centres meet centres."""
    step_m = length_m / n_pixels
    beyond = float(np.ptp(edges_m)) / step_m - n_pixels
    n = n_pixels + 2 * max(0, ceil(beyond / 2 - 0.25))
    return np.asarray((np.arange(n) - (n - 1) / 2) * step_m, dtype=np.float64)
