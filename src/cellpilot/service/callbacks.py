"""How a verb speaks to its caller while it works."""

import inspect
import warnings
from collections.abc import Callable

Warn = Callable[[str], None]
"""Hears a sentence about something that is hardly what was wanted."""


def untold(share: float) -> None:
    """A progress that nobody follows."""


def as_warning(message: str) -> None:
    """A sentence as a Python warning at the place that called cellpilot."""
    frame, level = inspect.currentframe(), 1
    while frame is not None and str(frame.f_globals.get("__name__")).partition(".")[0] == "cellpilot":
        frame, level = frame.f_back, level + 1
    warnings.warn(message, UserWarning, stacklevel=level)


def tell(warn: Warn, message: str | None) -> None:
    """Pass a sentence on, if there is one."""
    if message:
        warn(message)
