"""What formats have in common that hold the cells of a map and its attributes as JSON."""

import json
from typing import Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.maps.schema import CELL, FIELDS, RadioMap

VARIABLES = tuple(name for name, field in FIELDS.items() if field.dims == CELL)
"""Names of the variables over cells, SINR first."""


def attributes_json(dataset: RadioMap, **further: Any) -> str:
    """The attributes of a map, or an object that holds them as `attrs` beside `further`.

    NetCDF also allows arrays, which become lists. `InputError` for what is neither text nor number.
    """

    def plain(value: object) -> object:
        if isinstance(value, np.ndarray | np.generic) and value.dtype.kind in "biufU":
            return value.tolist()
        raise InputError(f"an attribute of the map is of type {type(value).__name__}; expected text, numbers or arrays of them")

    content = {**further, "attrs": dataset.attrs} if further else dataset.attrs
    return json.dumps(content, sort_keys=True, default=plain)
