"""What installed packages offer to cellpilot through entry points."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any

from cellpilot.errors import InputError

GROUPS = {
    "cellpilot.learners": "learner",
    "cellpilot.map_sources": "map source",
    "cellpilot.exports": "export",
}
"""Groups of entry points, and what one entry of each is."""


@cache
def offered(group: str) -> dict[str, Any]:
    """The objects that installed packages offer in a group, by name.

    `InputError` names an entry point that cannot be imported, or a name that two packages offer.
    """
    found: dict[str, Any] = {}
    for point in entry_points(group=group):
        if point.name in found:
            raise InputError(f"two packages offer the {GROUPS[group]} {point.name} (one is {point.value}): remove one of them")
        try:
            found[point.name] = point.load()
        except Exception as error:  # whatever somebody else's module does at its import
            raise InputError(
                f"the {GROUPS[group]} {point.name} ({point.value}) cannot be imported ({error}): remove it"
            ) from error
    return found
