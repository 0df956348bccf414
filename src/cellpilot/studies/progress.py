"""Progress of a study that is made of several trainings."""

from collections.abc import Callable


def within(progress: Callable[[float], None], i: int, n: int, share: float) -> None:
    """Report a share of part `i` of `n`."""
    progress((i + share) / n)
