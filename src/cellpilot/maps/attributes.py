"""The attributes of a map: which there are, of what kind, and what every file format can hold."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from cellpilot.errors import InputError

TEXT, NUMBER = "text", "a number"
KINDS = {
    "schema_version": NUMBER,
    "source": TEXT,
    "model": TEXT,
    "unknown": TEXT,
    "blocked_reasons": TEXT,
    "licence": TEXT,
    "datum": TEXT,
    "provenance": TEXT,
    "seed": NUMBER,
    "anchor_latitude_deg": NUMBER,
    "anchor_longitude_deg": NUMBER,
    "anchor_altitude_m": NUMBER,
    "sinr_correlation_m": NUMBER,
    "sinr_common_std_db": NUMBER,
    "import_account": TEXT,
    "fill_method": TEXT,
    "fill_radius_m": NUMBER,
    "fill_power": NUMBER,
    "fill_kernel": TEXT,
    "fill_posterior": TEXT,
    "trend": TEXT,
    "receiver": TEXT,
    "environment": TEXT,
    "los": TEXT,
    "rays": TEXT,
    "bin_m": NUMBER,
    "points_per_side": NUMBER,
    "noise_figure_db": NUMBER,
}
"""Attributes that cellpilot writes; those that begin with `calibration_` are numbers too."""


def plain_attributes(attributes: Mapping[Any, Any], where: str) -> dict[str, Any]:
    """The attributes with NumPy's numbers and one-element arrays as Python's; `InputError` naming one that no map can have.

    Known ones are of their kind; any other is text, a finite or infinite number, or a list of one of them.
    """
    return {str(name): _plain(str(name), value, where) for name, value in attributes.items()}


def _plain(name: str, value: Any, where: str) -> Any:
    if isinstance(value, np.ndarray | np.generic) and (value.ndim == 0 or (value.size == 1 and name in KINDS)):
        value = value.item()
    wanted = NUMBER if name.startswith("calibration_") else KINDS.get(name)
    is_text, is_number = isinstance(value, str), isinstance(value, int | float) and not isinstance(value, bool)
    if (wanted == TEXT and not is_text) or (wanted == NUMBER and not is_number):
        raise InputError(f"{where}: the attribute {name} is {_shown(value)}; expected {wanted}: correct or remove it")
    if is_number and isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise InputError(f"{where}: the attribute {name} is {_shown(value)}; expected at most 64 bits: correct or remove it")
    if wanted == NUMBER and not np.isfinite(value):
        raise InputError(f"{where}: the attribute {name} is {value}; expected a finite number: correct or remove it")
    if is_text:
        if "\0" in value or any("\ud800" <= letter <= "\udfff" for letter in value):
            raise InputError(f"{where}: the attribute {name} is {_shown(value)}, no Unicode text: correct or remove it")
    elif not is_number and not _is_list(value):
        raise InputError(
            f"{where}: the attribute {name} is {_shown(value)}; expected text, a number, or a list of one of them: change or"
            " remove it"
        )
    return value


def _is_list(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind in "iufUO" and all(isinstance(item, str | int | float) for item in value.ravel().tolist())
    if not isinstance(value, list | tuple) or not value:
        return False
    numbers = all(isinstance(item, int | float) and not isinstance(item, bool) and abs(item) < 2**63 for item in value)
    texts = all(isinstance(item, str) and item.isprintable() for item in value)
    return numbers or texts


def _shown(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
