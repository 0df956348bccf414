"""The bands of a GeoTIFF: which variable at which height each holds, and its values."""

from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.formats.cells import READ

if TYPE_CHECKING:
    from rasterio.io import DatasetReader

VARIABLE, HEIGHT_M = "VARIABLE", "HEIGHT_M"
"""Tags of a band; without VARIABLE it is taken for SINR."""


def check_georeferenced(file: "DatasetReader") -> None:
    """`InputError` unless an opened raster says where on Earth its pixels are."""
    if file.crs is None:
        raise InputError("no coordinate system; expected a georeferenced GeoTIFF: assign one (gdal_edit.py -a_srs EPSG:... FILE)")
    if file.transform.is_identity or file.transform.is_degenerate:
        raise InputError(
            "no corners and pixel size; expected a georeferenced GeoTIFF: assign them"
            " (gdal_edit.py -a_ullr WEST NORTH EAST SOUTH FILE)"
        )


def bands_of(file: "DatasetReader", given_m: tuple[float, ...] | None) -> tuple[list[float], dict[str, list[int]]]:
    """Increasing heights [m], and for each variable the numbers of its bands in that order.

    `given_m` are the heights of the SINR bands where the file does not state them. `InputError` for heights that are missing,
    contradictory or no numbers, and for a file without SINR.
    """
    numbers: dict[str, list[int]] = {}
    for band in range(1, file.count + 1):
        stated = file.tags(band).get(VARIABLE)
        numbers.setdefault(stated if stated in READ else "sinr_db", []).append(band)
    if "sinr_db" not in numbers:
        raise InputError(f"holds {', '.join(numbers)}, not SINR; a map needs sinr_db")
    result = {name: dict(zip(_heights(file, bands, given_m), bands, strict=True)) for name, bands in numbers.items()}
    z_m = sorted(result["sinr_db"])
    for name, bands in result.items():
        if sorted(bands) != z_m:
            raise InputError(
                f"{name} has bands at {_shown(sorted(bands))} and sinr_db at {_shown(z_m)}; expected the same heights"
            )
    return z_m, {name: [bands[height] for height in z_m] for name, bands in result.items()}


def values_of(file: "DatasetReader", bands: list[int]) -> NDArray[np.float64]:
    """Values of bands [band, row, column] in the band's unit, NaN where there are none."""
    if any("complex" in file.dtypes[band - 1] for band in bands):
        raise InputError(f"the bands are of type {file.dtypes[bands[0] - 1]}; expected real numbers")
    values = file.read(bands, masked=True).astype(np.float64).filled(np.nan)
    scale, offset = (np.array([each[band - 1] for band in bands]) for each in (file.scales, file.offsets))
    return np.asarray(values * scale[:, None, None] + offset[:, None, None])


def _heights(file: "DatasetReader", bands: list[int], given_m: tuple[float, ...] | None) -> list[float]:
    texts = [file.tags(band).get(HEIGHT_M) for band in bands]
    stated_m = [_number(text) for text in texts]
    if given_m is not None and len(given_m) != len(bands):
        raise InputError(f"{len(bands)} band(s), and {len(given_m)} height(s) given; expected one for each band")
    for band, text, stated, given in zip(bands, texts, stated_m, given_m or stated_m, strict=True):
        if given is None:
            wrong = f"{stated_m.count(None)} band(s) without a height" + (f" (band {band}: {text!r})" if text else "")
            raise InputError(f"{wrong}; give one for each: `heights_m` 30 50 ...")
        if stated not in (None, given):
            raise InputError(f"band {band} states a height of {stated:g} m, and {given:g} m is given; leave `heights_m` out")
    heights_m = [height for height in given_m or stated_m if height is not None]
    if len(set(heights_m)) < len(heights_m):
        raise InputError(f"bands at {_shown(heights_m)}; expected each height once")
    return heights_m


def _number(text: str | None) -> float | None:
    try:
        return float(text) if text is not None and isfinite(float(text)) else None
    except ValueError:
        return None


def _shown(heights_m: list[float]) -> str:
    return ", ".join(f"{height:g}" for height in heights_m) + " m"
