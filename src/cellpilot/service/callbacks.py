"""How a verb speaks to its caller while it works."""

import warnings
from collections.abc import Callable

Warn = Callable[[str], None]
"""Hears a sentence about something that is hardly what was wanted."""


def untold(share: float) -> None:
    """A progress that nobody follows."""


def as_warning(message: str) -> None:
    """A sentence as a Python warning."""
    warnings.warn(message, UserWarning, stacklevel=3)


def tell(warn: Warn, message: str | None) -> None:
    """Pass a sentence on, if there is one."""
    if message:
        warn(message)
