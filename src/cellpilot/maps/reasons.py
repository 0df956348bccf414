"""Why a cell may not be entered: a code for each cell, and the table of reasons that the codes count through."""

import json
import math
from collections.abc import Sequence
from dataclasses import MISSING, asdict, dataclass, fields
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.errors import InputError

if TYPE_CHECKING:
    from xarray import Dataset

TABLE = "blocked_reasons"
"""Attribute of a map: its reasons as JSON, in the order of their codes 1, 2, ..."""

MOST_REASONS = 255

Codes = NDArray[np.uint8]


@dataclass(frozen=True)
class Reason:
    """Why a cell may not be entered."""

    name: str
    source: str = ""  # the file, rule or model that says so
    lower_m: float | None = None  # limits in height above the datum [m]; None = unlimited
    upper_m: float | None = None
    datum: str = ""  # what the limits count from
    validity: str = ""  # when it holds, as its source words it
    lack_of_data: bool = False  # nothing forbids the cell but that its SINR is unknown: filling it frees it

    def __str__(self) -> str:
        """Name and source, for messages."""
        return f"{self.name}, {self.source}" if self.source else self.name


MARKED = Reason("marked in the map")
NO_SINR = Reason("SINR unknown", lack_of_data=True)
NO_MEASUREMENT = Reason("no measurement", lack_of_data=True)
NO_RAY = Reason("no ray arrives", lack_of_data=True)
INSIDE_BUILDING = Reason("inside a building")
IN_FILE = Reason("blocked in the file", "schema version 1")
IN_FILE_WITHOUT_SINR = Reason("blocked in the file, SINR unknown", "schema version 1", lack_of_data=True)


def blocked_cells(radio_map: "Dataset") -> NDArray[np.bool_]:
    """Cells of a map that may not be entered, `[z, y, x]`."""
    return np.asarray(radio_map["blocked_reason"].values > 0)


def reasons_of(radio_map: "Dataset") -> tuple[Reason, ...]:
    """The table of reasons of a valid map: code i is entry i - 1."""
    return parsed_reasons(radio_map.attrs.get(TABLE, "[]"), "the map")


def reasons_text(reasons: Sequence[Reason]) -> str:
    """The table as the attribute holds it: what differs from the defaults of `Reason`."""
    plain = {field.name: field.default for field in fields(Reason) if field.default is not MISSING}
    kept = [{name: value for name, value in asdict(r).items() if name not in plain or value != plain[name]} for r in reasons]
    return json.dumps(kept, sort_keys=True)


def parsed_reasons(text: object, where: str) -> tuple[Reason, ...]:
    """The reasons in an attribute; `InputError` if it is no such table."""
    try:
        entries = json.loads(str(text))
        if not isinstance(entries, list) or len(entries) > MOST_REASONS:
            raise ValueError(f"expected a list of at most {MOST_REASONS}")
        return tuple(_parsed(entry) for entry in entries)
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"{where}: the attribute {TABLE} is no table of reasons ({error!s:.120}); expected a JSON list of objects with a"
            " name: correct it"
        ) from None


def _parsed(entry: object) -> Reason:
    """The reason of one entry; `ValueError` for a field that is missing, not known, or of another kind."""
    if not isinstance(entry, dict) or "name" not in entry:
        raise ValueError(f"{entry!r:.40} has no name")
    known = {field.name: field.default for field in fields(Reason)}
    for name, value in entry.items():
        if name not in known:
            raise ValueError(f"{name!r:.40} is none of {', '.join(known)}")
        if known[name] is None:  # a limit
            fits = value is None or (type(value) in (int, float) and math.isfinite(value))
        elif name == "lack_of_data":
            fits = isinstance(value, bool)
        else:
            fits = isinstance(value, str) and not any("\ud800" <= letter <= "\udfff" for letter in value)
        if not fits:
            raise ValueError(f"{name} is {value!r:.40}")
    return Reason(**entry)


def with_reason(
    codes: ArrayLike, reasons: Sequence[Reason], cells: NDArray[np.bool_], reason: Reason
) -> tuple[Codes, tuple[Reason, ...]]:
    """Codes and table after `cells` got `reason`, which enters the table unless it is there or no cell gets it.

    `InputError` for more than 255 reasons.
    """
    reasons = tuple(reasons)
    if not cells.any():
        return np.asarray(codes, np.uint8), reasons
    if reason not in reasons:
        reasons += (reason,)
    if len(reasons) > MOST_REASONS:
        raise InputError(f"{len(reasons)} reasons for blocked cells; at most {MOST_REASONS} have a code: join some")
    return np.where(cells, reasons.index(reason) + 1, codes).astype(np.uint8), reasons


def reasons_of_mask(blocked: NDArray[np.bool_], unknown: NDArray[np.bool_]) -> tuple[Codes, tuple[Reason, ...]]:
    """Codes and table for a file of schema version 1, which says which cells are blocked and not why."""
    codes, reasons = with_reason(np.zeros(blocked.shape, np.uint8), (), blocked & ~unknown, IN_FILE)
    return with_reason(codes, reasons, blocked & unknown, IN_FILE_WITHOUT_SINR)


def for_lack_of_data(codes: Codes, reasons: Sequence[Reason]) -> NDArray[np.bool_]:
    """Cells that are blocked only because their SINR is unknown, in the shape of the codes."""
    return np.array([False, *(reason.lack_of_data for reason in reasons)])[codes]


def counted_reasons(codes: Codes, reasons: Sequence[Reason]) -> str:
    """Cells of each reason that occurs, in words, such as "10 inside a building, 2 no ray arrives"."""
    count = np.bincount(np.ravel(codes), minlength=len(reasons) + 1)[1:]
    return ", ".join(f"{n} {reason.name}" for n, reason in zip(count.tolist(), reasons, strict=True) if n)
