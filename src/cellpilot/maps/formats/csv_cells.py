"""CSV: one line for each cell with its place in metres and, for a map with an anchor, in degrees.

The first line is a comment that holds the attributes as JSON; without it the file is a map all the same, made elsewhere.
"""

import csv
import io
import json
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.errors import InputError
from cellpilot.maps.formats.cells import VARIABLES, attributes_json
from cellpilot.maps.geodesy import to_degrees
from cellpilot.maps.schema import CELL, RadioMap, anchor_of, make_map, validate
from cellpilot.maps.text_table import Column, open_table
from cellpilot.storage import write_atomically

MARK = "# cellpilot map "
PLACES = ("x_m", "y_m", "z_m")


def write(dataset: RadioMap, path: Path) -> None:
    """Write the variables over cells of a valid map; what belongs to sectors is left out."""
    names = [name for name in VARIABLES if name in dataset]
    z_m, y_m, x_m = (axis.ravel() for axis in np.meshgrid(*(dataset[axis].values for axis in CELL), indexing="ij"))
    columns = {"x_m": x_m, "y_m": y_m, "z_m": z_m}
    anchor = anchor_of(dataset)
    if anchor is not None:
        columns |= dict(zip(("latitude", "longitude"), to_degrees(x_m, y_m, anchor), strict=True))
    columns |= {name: dataset[name].values.ravel() for name in names}
    texts = {name: [_text(value) for value in values.tolist()] for name, values in columns.items()}
    # Float32 values are written as short as they can be without loss.
    texts |= {name: [_text(v) for v in columns[name].astype(str)] for name in names if columns[name].dtype == np.float32}

    try:
        attributes = attributes_json(dataset)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None

    file = io.StringIO()
    file.write(MARK + attributes + "\n")
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(texts)
    writer.writerows(zip(*texts.values(), strict=True))
    write_atomically(path, file.getvalue())


def read(path: Path) -> RadioMap:
    """The map in a CSV file; cells that no line names are unknown. `InputError` for a cell named twice or off the grid."""
    table, rows = open_table(path, "map with one line a cell")
    table.require(
        (*PLACES, "sinr_db"), "; expected a map with one line a cell (a measured log is imported: cellpilot map import)"
    )
    names = [name for name in VARIABLES if name in table.names]
    limits = {name: Column(name, -(2.0**31), 2.0**31) for name in (*PLACES, *names)}
    lines, cells = [], []
    for row in rows:
        row.check_width()
        place = [row.needed(limits[name]) for name in PLACES]
        cells.append(place + [row.number(limits[name]) for name in names])
        lines.append(row.line)
    if not cells:
        raise InputError(f"{path}: no cells below the header; expected one line for each")
    values = np.array(cells)
    (x_m, ix), (y_m, iy), (z_m, iz) = (np.unique(values[:, i], return_inverse=True) for i in range(3))
    index = (iz * len(y_m) + iy) * len(x_m) + ix
    unique, first = np.unique(index, return_index=True)
    if len(unique) < len(index):
        again = int(np.setdiff1d(np.arange(len(index)), first)[0])
        raise InputError(
            f"{path}, line {lines[again]}: the cell at {values[again, :3].tolist()} is there already; expected one line for each"
        )
    shape = len(z_m), len(y_m), len(x_m)
    arrays = {name: _gridded(values[:, 3 + i], index, shape, name) for i, name in enumerate(names)}
    optional: dict[str, ArrayLike] = {name: arrays[name] for name in ("sinr_spread_db", "serving_sector") if name in arrays}
    attributes = _attributes(path)
    try:
        dataset = make_map(
            arrays["sinr_db"],
            x_m=x_m,
            y_m=y_m,
            z_m=z_m,
            source="CSV",
            sinr_std_db=arrays.get("sinr_std_db", 0.0),
            count=arrays.get("count", 0),
            filled=arrays.get("filled", False),
            blocked=arrays.get("blocked"),
            optional=optional,
            unknown=str(attributes.get("unknown", "blocked")),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    if attributes:
        dataset.attrs = attributes
    return validate(dataset, str(path))


def _gridded(values: np.ndarray, index: np.ndarray, shape: tuple[int, ...], name: str) -> np.ndarray:
    """Values over cells; where there is no line or no number, what the schema has for cells of which nothing is known."""
    unknown = {"count": 0.0, "filled": 0.0, "blocked": 1.0, "serving_sector": -1.0}.get(name, np.nan)
    array = np.full(np.prod(shape), unknown)
    array[index] = np.where(np.isnan(values), unknown, values)
    return array.reshape(shape)


def _attributes(path: Path) -> dict[str, Any]:
    with path.open(encoding="utf-8-sig") as file:
        first = file.readline()
    if not first.startswith(MARK):
        return {}
    try:
        return dict(json.loads(first.removeprefix(MARK)).items())
    except (ValueError, AttributeError):
        raise InputError(
            f"{path}, line 1: the attributes are no JSON; expected the line as cellpilot wrote it, or none"
        ) from None


def _text(value: float | int | bool | str) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, str):
        return "" if value == "nan" else value
    return "" if isinstance(value, float) and isnan(value) else repr(value)
