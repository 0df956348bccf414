"""CSV: one line for each cell with its place in metres and, for a map with an anchor, in degrees.

The first line is a comment that holds the attributes as JSON; without it the file is a map all the same, made elsewhere.
"""

import csv
import hashlib
import io
import json
from collections.abc import Iterable
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.maps.fields import CELL
from cellpilot.maps.formats.cells import (
    READ,
    VARIABLES,
    FloatArray,
    attributes_json,
    map_of_cells,
    stated_reasons,
    with_attributes,
)
from cellpilot.maps.geodesy import to_degrees
from cellpilot.maps.limits import check_size
from cellpilot.maps.schema import RadioMap, anchor_of
from cellpilot.maps.text_table import LONGEST_LINE, Column, open_table
from cellpilot.storage import parse_json, write_atomically

CSV_MARK = "# cellpilot map "
SUM = "sha256"
"""Entry of line 1: checksum of the other attributes and of all lines below, whatever their line ends."""
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
        attributes = parse_json(attributes_json(dataset), str(path), "correct the attributes")
    except InputError as error:
        raise InputError(f"{path}: {error}") from None

    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(texts)
    writer.writerows(zip(*texts.values(), strict=True))
    below = file.getvalue()
    attributes |= {SUM: _sum(attributes, [below.encode()])}
    write_atomically(path, f"{CSV_MARK}{json.dumps(attributes, sort_keys=True)}\n{below}")


def read(path: Path) -> RadioMap:
    """The map in a CSV file; cells that no line names are unknown. `InputError` for a cell named twice or off the grid."""
    table, rows = open_table(path, "map with one line a cell")
    table.require(
        (*PLACES, "sinr_db"), "; expected a map with one line a cell (a measured log is imported: cellpilot map import)"
    )
    attributes = read_attributes(path)
    reasons = stated_reasons(attributes, str(path))
    names = [name for name in READ if name in table.names]
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
    check_size((len(x_m), len(y_m), len(z_m)), f"{path}: lines at {len(x_m)} x {len(y_m)} x {len(z_m)} places")
    index = (iz * len(y_m) + iy) * len(x_m) + ix
    unique, first = np.unique(index, return_index=True)
    if len(unique) < len(index):
        again = int(np.setdiff1d(np.arange(len(index)), first)[0])
        raise InputError(
            f"{path}, line {lines[again]}: the cell at {values[again, :3].tolist()} is there already; expected one line for each"
        )
    shape = len(z_m), len(y_m), len(x_m)
    arrays = {name: _gridded(values[:, 3 + i], index, shape) for i, name in enumerate(names)}
    try:
        unknown = str(attributes.get("unknown", "blocked"))
        dataset = map_of_cells(arrays, reasons, x_m=x_m, y_m=y_m, z_m=z_m, source="CSV", unknown=unknown)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return with_attributes(dataset, attributes, str(path)) if attributes else dataset


def _gridded(values: FloatArray, index: np.ndarray, shape: tuple[int, ...]) -> FloatArray:
    """Values over cells, NaN where there is no line or no number."""
    array = np.full(np.prod(shape), np.nan)
    array[index] = values
    return array.reshape(shape)


def read_attributes(path: Path) -> dict[str, Any]:
    """The attributes in line 1; `InputError` if it is damaged, or its checksum is that of other lines."""
    with path.open("rb") as file:
        first = file.readline(LONGEST_LINE).removeprefix(b"\xef\xbb\xbf")
        if not first.startswith(CSV_MARK.encode()):
            return {}
        text = first.decode("utf-8", "replace").removeprefix(CSV_MARK)
        attributes = parse_json(text, f"{path}, line 1", "expected the line as cellpilot wrote it, or none")
        stated = attributes.pop(SUM, None)
        if stated is not None and stated != _sum(attributes, file):
            raise InputError(
                f"{path}: checksum mismatch: the file is damaged, or was changed; if you changed it yourself, remove {SUM!r} from"
                " line 1"
            )
    return attributes


def has_checksum(path: Path) -> bool:
    """Whether line 1 holds a checksum."""
    with path.open("rb") as file:
        return f'"{SUM}"'.encode() in file.readline(LONGEST_LINE)


def _sum(attributes: dict[str, Any], lines: Iterable[bytes]) -> str:
    sha = hashlib.sha256(json.dumps(attributes, sort_keys=True).encode())
    for line in lines:
        sha.update(line.replace(b"\r\n", b"\n"))
    return sha.hexdigest()


def _text(value: float | int | bool | str) -> str:
    if isinstance(value, bool):
        return str(int(value))
    if isinstance(value, str):
        return "" if value == "nan" else value
    return "" if isinstance(value, float) and isnan(value) else repr(value)
