"""Numbers as people read them."""

import math
from typing import Any

MISSING = "–"
EXACT_TO = 1e-9
"""Shares are sums of probabilities, which are exact only so far."""


def percent(share: float, digits: int = 2) -> str:
    """A share as percent; what is neither none nor all is never rounded to 0 or 100."""
    if abs(share - round(share)) < EXACT_TO:
        share = float(round(share))
    for more in range(digits, digits + 8):
        text = f"{100 * share:.{more}f}"
        if share in (0.0, 1.0) or float(text) not in (0.0, 100.0):
            break
    return f"{text} %"


def number(value: float, digits: int = 2) -> str:
    """A number with fixed digits; infinity as its sign."""
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    # Adding zero turns a rounded -0.0 into 0.0.
    return f"{round(value, digits) + 0.0:.{digits}f}".replace("-", "−")


def show(value: Any, form: str) -> str:
    """A metric as text: `form` is percent, number, score or steps; a dash where there is none."""
    if value is None or (isinstance(value, float) and math.isnan(value)):
        return MISSING
    if form == "percent":
        return percent(value)
    return number(value, {"number": 2, "score": 3, "steps": 0}.get(form, 2))


def count(value: float) -> str:
    """A count with thousands apart by a narrow space."""
    return f"{value:,.0f}".replace(",", "\u202f")
