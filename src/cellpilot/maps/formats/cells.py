"""What formats have in common that hold the cells of a map and its attributes as JSON."""

import json
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.fields import BLOCKED, CELL, FIELDS
from cellpilot.maps.reasons import MOST_REASONS, NO_SINR, TABLE, Reason, parsed_reasons, reasons_of_mask, with_reason
from cellpilot.maps.schema import RadioMap, make_map, validate

VARIABLES = tuple(name for name, field in FIELDS.items() if field.dims == CELL)
"""Names of the variables over cells, SINR first."""

READ = {name: FIELDS[name] for name in VARIABLES} | {"blocked": BLOCKED}
"""What is read: these, and what schema version 1 had."""


def map_of_cells(
    values: dict[str, FloatArray], reasons: tuple[Reason, ...] | None, outside: NDArray[np.bool_] | bool = False, **about: Any
) -> RadioMap:
    """The map of values over cells `[z, y, x]`, NaN where the file has none.

    Such a cell has no samples, is not filled, of no sector and blocked, as is one `outside` what the file covers. A mask
    `blocked` takes the place of `blocked_reason` in files of schema version 1. `reasons` is the table of the file, or None.
    """
    free_if_unknown = about.get("unknown", "blocked") == "bad"
    codes, reasons = _blocked_reasons(values, reasons, outside, free_if_unknown)
    without = {"count": 0.0, "filled": 0.0, "serving_sector": -1.0}
    whole = {name: np.where(np.isnan(array), without.get(name, np.nan), array) for name, array in values.items()}
    optional: dict[str, ArrayLike] = {name: whole[name] for name in ("sinr_spread_db", "serving_sector") if name in whole}
    return make_map(
        values["sinr_db"],
        sinr_std_db=whole.get("sinr_std_db", 0.0),
        count=whole.get("count", 0),
        filled=whole.get("filled", False),
        blocked_reason=codes,
        reasons=reasons,
        optional=optional,
        **about,
    )


def _blocked_reasons(
    values: dict[str, FloatArray], reasons: tuple[Reason, ...] | None, outside: NDArray[np.bool_] | bool, free_if_unknown: bool
) -> tuple[NDArray[np.uint8], tuple[Reason, ...]]:
    """Codes `[z, y, x]` and table, from whichever of `blocked_reason`, `blocked` and `sinr_db` the file has."""
    unknown = np.isnan(values["sinr_db"])
    if "blocked_reason" in values:
        nowhere = np.isnan(values["blocked_reason"])
        stated = np.where(nowhere, 0.0, values["blocked_reason"])
        codes = stated.clip(0, MOST_REASONS).astype(np.uint8)
        if (codes != stated).any():
            raise InputError(f"blocked_reason holds values that are not uint8; expected whole numbers from 0 to {MOST_REASONS}")
        if reasons is None:
            reasons = tuple(Reason(f"reason {code} of the file") for code in range(1, int(codes.max()) + 1))
        return with_reason(codes, reasons, nowhere, NO_SINR)
    if "blocked" in values:
        mask = np.where(np.isnan(values["blocked"]), 1.0, values["blocked"])
        if not np.isin(mask, (0, 1)).all():
            raise InputError("blocked holds values that are not bool; expected true or false (0 or 1)")
        return reasons_of_mask(mask > 0, unknown)
    return with_reason(np.zeros(unknown.shape, np.uint8), reasons or (), (unknown & (not free_if_unknown)) | outside, NO_SINR)


def with_attributes(dataset: RadioMap, attributes: Mapping[str, Any], where: str) -> RadioMap:
    """A map made by `map_of_cells` with the attributes of its file, whose version it need not have any more."""
    kept = {name: dataset.attrs[name] for name in ("schema_version", TABLE)}
    version = attributes.get("schema_version")
    dataset.attrs = {**attributes, **(kept if version == 1 else {TABLE: kept[TABLE]})}
    return validate(dataset, where)


def stated_reasons(attributes: Mapping[str, Any], where: str) -> tuple[Reason, ...] | None:
    """The table of reasons in the attributes of a file; None where it has none."""
    return parsed_reasons(attributes[TABLE], where) if TABLE in attributes else None


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
