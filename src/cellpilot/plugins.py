"""What installed packages offer to cellpilot through entry points."""

from collections.abc import Container
from functools import cache
from importlib.metadata import entry_points
from typing import Any, NamedTuple

from cellpilot.errors import InputError

GROUPS = {
    "cellpilot.learners": "learner",
    "cellpilot.map_sources": "map source",
    "cellpilot.exports": "export",
}
"""Groups of entry points, and what one entry of each is."""


class Offer(NamedTuple):
    """What a package offers under a name, and where it lies (`module:name`)."""

    thing: Any
    origin: str


@cache
def offered(group: str) -> dict[str, Offer]:
    """The objects that installed packages offer in a group, by name.

    `InputError` names an entry point that cannot be imported, or a name that two packages offer.
    """
    found: dict[str, Offer] = {}
    for point in entry_points(group=group):
        if point.name in found:
            raise InputError(f"two packages offer the {GROUPS[group]} {point.name} (one is {point.value}): remove one of them")
        try:
            found[point.name] = Offer(point.load(), point.value)
        except Exception as error:  # whatever somebody else's module does at its import
            raise InputError(
                f"the {GROUPS[group]} {point.name} ({point.value}) cannot be imported ({error}): remove it"
            ) from error
    return found


def refuse_taken(group: str, name: str, origin: str, taken: Container[str]) -> None:
    """`InputError` for a name that cellpilot has itself, or that is not in small letters."""
    if name in taken or name != name.lower():
        raise InputError(f"the {GROUPS[group]} {name} ({origin}): its name is taken or not in small letters; choose another")
