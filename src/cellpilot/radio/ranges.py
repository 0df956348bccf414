"""Checks of physical quantities against the range a model is defined for."""

import numpy as np
from numpy.typing import ArrayLike

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError, RangeError


def as_floats(values: ArrayLike, what: str) -> FloatArray:
    """The values as float64; `InputError` naming `what` if they are not numbers."""
    try:
        return np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise InputError(f"{what} is {values!r}; expected numbers") from error


def check_range(values: ArrayLike, what: str, low: float, high: float, unit: str) -> FloatArray:
    """The values as float64 if all are finite and in `low..high`, else `RangeError` with the first offender."""
    array = as_floats(values, what)
    if array.size and low <= array.min() and array.max() <= high and np.isfinite([array.min(), array.max()]).all():
        return array
    wrong = ~((array >= low) & (array <= high) & np.isfinite(array))
    if wrong.any():
        found = f"{array[wrong].flat[0]:g} {unit}".rstrip()
        raise RangeError(f"{what} is {found}; expected {_range(low, high, unit)}")
    return array


def _range(low: float, high: float, unit: str) -> str:
    if np.isinf(low):
        return "a finite number"
    return (f"{low:g}..{high:g} {unit}" if np.isfinite(high) else f"at least {low:g} {unit}").rstrip()
