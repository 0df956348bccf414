"""GeoTIFF: a band of SINR for each height, then bands of what else is known about the cells (extra `geo`).

A map's local metres are degrees times two constants (see `geodesy`), so a map is written in WGS84 degrees (EPSG:4326)
without resampling, and comes back equal. Any other raster, and a map that was moved, cropped or resampled since it was
written, is read onto a local grid (see `foreign_raster`).
"""

import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import xarray as xr
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.attributes import plain_attributes
from cellpilot.maps.fields import FIELDS
from cellpilot.maps.formats.cells import READ, VARIABLES, attributes_json, map_of_cells, stated_reasons, with_attributes
from cellpilot.maps.formats.foreign_raster import WGS84, FloatArray, apply, local_grid
from cellpilot.maps.formats.raster_bands import bands_of, check_georeferenced, values_of
from cellpilot.maps.geodesy import Anchor, metres_per_degree, to_degrees
from cellpilot.maps.limits import check_size
from cellpilot.maps.reasons import NO_SINR, blocked_cells, reasons_of
from cellpilot.maps.schema import RadioMap, anchor_of, make_map
from cellpilot.storage import check_seal, parse_json, seal, write_atomically

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

TIFF_BEGINS = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
TAG = "CELLPILOT"
"""Tag that holds the map's attributes, variables and local coordinates as JSON."""

TOLERANCE_M = 1e-3
"""How far the corners of a raster may lie from where `write` puts them for the local coordinates of its tag to be taken."""


def write(dataset: RadioMap, path: Path, variable: str | None = None) -> None:
    """Write a map that has an anchor; unknown is NaN, which is also the nodata value.

    SINR comes first, so that band i is height i, then each other variable over cells that says something; a `variable` that
    is named is written alone. `InputError` for a map without an anchor or with a single column and row, and for a variable
    that it does not have or that belongs to sectors.
    """
    rasterio = _rasterio()
    anchor = anchor_of(dataset)
    if anchor is None:
        raise InputError(f"{path}: the map lies nowhere on Earth; give it an anchor (latitude and longitude of x = y = 0)")
    x_m, y_m, z_m = (dataset[axis].values for axis in "xyz")
    try:
        layers = _layers(dataset, variable)
        transform = rasterio.Affine(*_transform(x_m, y_m, anchor))
        tag = attributes_json(dataset, x=x_m.tolist(), y=y_m.tolist(), variables=list(layers))
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    # Beyond 2^24 whole numbers have gaps in float32; all bands of a GeoTIFF are of one type.
    exact = all(np.array_equal(values.astype(np.float32), values, equal_nan=True) for values in layers.values())
    profile = {
        "driver": "GTiff",
        "width": len(x_m),
        "height": len(y_m),
        "count": len(layers) * len(z_m),
        "dtype": "float32" if exact else "float64",
        "crs": WGS84,
        "transform": transform,
        "nodata": float("nan"),
        "compress": "deflate",
        "interleave": "band",
    }

    with rasterio.MemoryFile() as memory:
        with memory.open(**profile) as file:
            file.update_tags(**{TAG: tag})
            bands = [(name, iz, height_m) for name in layers for iz, height_m in enumerate(z_m.tolist())]
            for band, (name, iz, height_m) in enumerate(bands, 1):
                file.write(layers[name][iz, ::-1].astype(profile["dtype"]), band)  # rasters begin in the north-west
                file.set_band_description(band, f"{name} at {height_m:g} m")
                file.update_tags(band, VARIABLE=name, HEIGHT_M=repr(height_m))
                file.set_band_unit(band, FIELDS[name].units)

        content = bytes(memory.read())
    write_atomically(path, seal(content))


def read(path: Path, heights_m: tuple[float, ...] | None = None) -> RadioMap:
    """The map in a GeoTIFF of SINR [dB]; bands of other variables are taken if they say so, as `write` does it.

    `heights_m` gives the height of each band where the file does not say. `InputError` for a file without a coordinate
    system, with bands whose heights nobody states or that states others, or that is no raster.
    """
    rasterio = _rasterio()
    check_seal(path)
    _check_sidecars(path)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", rasterio.errors.NotGeoreferencedWarning)  # it is refused below, in words
            # GDAL takes a file for whatever its first bytes say, and some kinds describe files elsewhere, on other machines too.
            opened = rasterio.open(path, driver="GTiff")
        with opened as file:
            return _map(file, heights_m)
    except (rasterio.errors.RasterioError, MemoryError, ValueError, IndexError) as error:
        if isinstance(error, InputError):
            raise InputError(f"{path}: {error}") from None
        raise InputError(f"{path}: not a readable GeoTIFF ({' '.join(str(error).split())[:120]})") from None


def has_checksum(path: Path) -> bool:
    """Whether the file ends with a checksum."""
    return check_seal(path)


def _check_sidecars(path: Path) -> None:
    """`InputError` for a mask or overview beside the file that is no TIFF: GDAL opens those by themselves."""
    for suffix in (".msk", ".ovr"):
        beside = path.with_name(path.name + suffix)
        if beside.is_file():
            with beside.open("rb") as file:
                if file.read(4) not in TIFF_BEGINS:
                    raise InputError(f"{beside}: no TIFF; expected a mask or overview of {path.name}: remove it")


def _rasterio() -> Any:
    try:
        import rasterio
        import rasterio.errors
    except ImportError:
        raise InputError("GeoTIFF files need the package rasterio: pip install 'cellpilot[geo]'") from None
    return rasterio


def _layers(dataset: RadioMap, variable: str | None) -> dict[str, NDArray[Any]]:
    """What the bands are to hold: SINR, and whatever a reader would not assume of a map that has nothing else."""
    if variable is not None and variable not in dataset.data_vars:
        raise InputError(f"the map has no {variable}; it has {', '.join(map(str, dataset.data_vars))}")
    if variable is not None and variable not in VARIABLES:
        raise InputError(f"{variable} belongs to sectors; a GeoTIFF holds what belongs to cells: {', '.join(VARIABLES)}")
    values = {name: dataset[name].values for name in VARIABLES if name in dataset}
    if variable is not None:
        return {variable: values[variable]}
    x_m, y_m, z_m = (dataset[axis].values for axis in "xyz")
    unknown = dataset.attrs.get("unknown", "blocked")
    assumed = make_map(values["sinr_db"], x_m=x_m, y_m=y_m, z_m=z_m, source="", unknown=unknown).drop_vars("sinr_db")
    if blocked_cells(dataset).any() and reasons_of(dataset)[0] != NO_SINR:
        assumed = assumed.drop_vars("blocked_reason")  # the same codes stand for another reason
    return {
        name: array
        for name, array in values.items()
        if name not in assumed or not np.array_equal(array, assumed[name].values, equal_nan=True)
    }


def _transform(x_m: FloatArray, y_m: FloatArray, anchor: Anchor) -> tuple[float, ...]:
    """Of columns and rows into longitude and latitude [deg]: the six numbers of an affine transform.

    A single column is as wide as the rows are high, and the other way round; `InputError` for a single column and row.
    """
    steps_m = [(axis[-1] - axis[0]) / (len(axis) - 1) for axis in (x_m, y_m) if len(axis) > 1]
    if not steps_m:
        raise InputError("one column and one row of cells, whose size nothing tells; expected more: write it as .nc or .csv")
    per_longitude_m, per_latitude_m = metres_per_degree(anchor.latitude_deg)
    step_x_deg, step_y_deg = float(steps_m[0] / per_longitude_m), float(steps_m[-1] / per_latitude_m)
    north_deg, west_deg = to_degrees(x_m[0], y_m[-1], anchor)
    return step_x_deg, 0.0, float(west_deg) - step_x_deg / 2, 0.0, -step_y_deg, float(north_deg) + step_y_deg / 2


class Tag(NamedTuple):
    """What `write` left in a file."""

    x_m: FloatArray
    y_m: FloatArray
    anchor: Anchor
    variables: tuple[str, ...]
    attributes: dict[str, Any]


def _tag(file: "DatasetReader") -> Tag | None:
    """The tag of a file that has one; `InputError` for a damaged one."""
    if TAG not in file.tags():
        return None
    remedy = f"restore the file, or remove the tag to read it as a raster of unknown origin (gdal_edit.py -unsetmd {TAG} FILE)"
    tag = parse_json(file.tags()[TAG], f"the tag {TAG}", remedy)
    try:
        x_m, y_m = (np.array(tag[axis], dtype=np.float64) for axis in "xy")
        attributes = plain_attributes(tag["attrs"], f"the tag {TAG}")
        anchor = anchor_of(xr.Dataset(attrs=attributes))
        variables = tuple(v for v in tag["variables"] if v in READ)
        if anchor is None or not variables or x_m.ndim != 1 or y_m.ndim != 1:
            raise ValueError("no anchor, variables or coordinates")
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"the tag {TAG} is damaged ({error!r}); {remedy}") from None
    return Tag(x_m, y_m, anchor, variables, attributes)


def _lies_as_written(file: "DatasetReader", tag: Tag) -> bool:
    """Whether coordinate system, size and corners are still those of `write`: other tools copy the tag to what they make."""
    if file.crs != WGS84 or (tag.x_m.shape, tag.y_m.shape) != ((file.width,), (file.height,)):
        return False
    columns, rows = np.array([(0, 0), (file.width, 0), (0, file.height), (file.width, file.height)]).T
    written = _transform(tag.x_m, tag.y_m, tag.anchor)
    corners, expected = (np.stack(apply(transform, columns, rows)) for transform in (file.transform, written))
    off_m = (corners - expected) * np.array([metres_per_degree(tag.anchor.latitude_deg)]).T
    return bool(np.abs(off_m).max() <= TOLERANCE_M)


def _map(file: "DatasetReader", heights_m: tuple[float, ...] | None) -> RadioMap:
    check_georeferenced(file)
    check_size((file.width, file.height, file.count))
    z_m, bands = bands_of(file, heights_m)
    values = {name: values_of(file, numbers) for name, numbers in bands.items()}
    tag = _tag(file)
    _check_whole(values)
    reasons = None if tag is None else stated_reasons(tag.attributes, f"the tag {TAG}")
    if tag is not None:
        lost = [name for name in tag.variables if name not in values and READ[name].required]
        if lost:
            raise InputError(
                f"the bands of {', '.join(lost)} are missing, which the map had; take all of them along, or remove the tag"
                f" {TAG} to read what is left for the whole map (gdal_edit.py -unsetmd FILE)"
            )
        if _lies_as_written(file, tag):
            values = {name: array[:, ::-1] for name, array in values.items()}
            unknown = tag.attributes.get("unknown", "blocked")
            own = map_of_cells(values, reasons, x_m=tag.x_m, y_m=tag.y_m, z_m=z_m, source="GeoTIFF", unknown=unknown)
            return with_attributes(own, tag.attributes, "the map")
    grid = local_grid(file)
    values = {name: grid.sample(array) for name, array in values.items()}
    about: dict[str, Any] = {"source": "GeoTIFF", "model": f"raster in {file.crs}", "anchor": grid.anchor}
    if tag is not None:
        # Of another area or resampled, a map still is a simulation or measured, and as free to use.
        about |= {name: tag.attributes[name] for name in ("source", "licence", "unknown") if name in tag.attributes}
    return map_of_cells(values, reasons, ~grid.inside, x_m=grid.x_m, y_m=grid.y_m, z_m=z_m, **about)


def _check_whole(values: dict[str, FloatArray]) -> None:
    """`InputError` where whole numbers have fractions."""
    averaged = [n for n, array in values.items() if READ[n].dtype is not np.float32 and (array % 1 > 0).any()]
    if averaged:
        raise InputError(f"{', '.join(averaged)} in fractions: the raster was averaged; resample it by nearest pixels (-r near)")
