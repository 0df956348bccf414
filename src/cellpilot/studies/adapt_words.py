"""What `cellpilot adapt` found, as a table and in sentences."""

from typing import TYPE_CHECKING

import numpy as np

from cellpilot.evaluate.statistics import half_interval

if TYPE_CHECKING:
    import xarray as xr

from cellpilot.studies.adapt_arms import NOTHING, PRIOR

SHOWN_FLIGHTS = (0, 1, 3, 5, 10, 20, 50, 100, 200, 500, 1_000)
"""Numbers of flights with a row in the table."""


def summary(data: "xr.Dataset") -> list[list[str]]:
    """Mean score of each arm and half of its 95 % interval, after each number of flights; first the headings.

    An arm that leaves some pair unreached at any time has a column with the share it reaches. Where both are there, the
    lead of the map learner with the prior over the one without is the mean of the differences seed by seed.
    """
    arms, flights = data["arm"].values.tolist(), data["flights"].values.tolist()
    columns: dict[str, list[str]] = {"flights": [str(n) for n in flights]}
    for arm in arms:
        columns[arm] = _with_interval(data["score"].sel(arm=arm))
        reached = data["reached_share"].sel(arm=arm)
        if (reached < 1).any():
            columns[f"{arm}: reached"] = [f"{100 * share:.1f} %" for share in reached.mean("seed").values]
    if {PRIOR, NOTHING} <= set(arms):
        columns["lead of the prior"] = _with_interval(data["score"].sel(arm=PRIOR) - data["score"].sel(arm=NOTHING), "+.3f")
    rows = [list(row) for row in zip(*columns.values(), strict=True)]
    return [list(columns), *(row for n, row in zip(flights, rows, strict=True) if n in SHOWN_FLIGHTS or n == flights[-1])]


def _with_interval(values: "xr.DataArray", form: str = ".3f") -> list[str]:
    """Mean over seeds and half of its 95 % interval, for each number of flights."""
    scores = values.transpose("flights", "seed").values
    spread = ["" if np.isnan(half) else f" ± {half:.3f}" for half in half_interval(scores)]
    return [f"{mean:{form}}{plus_minus}" for mean, plus_minus in zip(scores.mean(-1), spread, strict=True)]


def in_words(data: "xr.Dataset") -> str:
    """How like A and B are, as `likeness` found, and what the best of all policies of A is worth in B."""
    like = data.attrs
    return (
        f"A and B: correlation {like['correlation']:.2f}; {like['threshold_agreement']:.0%} of the cells on the same side of the "
        f"threshold (below it: {like['low_share_a']:.0%} in A, {like['low_share_b']:.0%} in B); mean of A minus mean of B "
        f"{like['level_difference_db']:+.1f} dB; the exact optimum of A scores {like['score_of_optimum_of_a']:.3f} in B"
    )


def verdict(data: "xr.Dataset", good: float = 0.9) -> list[str]:
    """In words: how A as a prior compares with none, over the flights, seed by seed."""
    if not {PRIOR, NOTHING} <= set(data["arm"].values.tolist()):
        return []
    flights = data["flights"].values
    prior, nothing = (data["score"].sel(arm=name).values for name in (PRIOR, NOTHING))
    if len(prior) == 1:
        return ["A confidence interval needs at least two seeds: give `seeds` 2 or more to compare the prior with none"]
    difference = (prior - nothing).T
    mean, half = difference.mean(-1), half_interval(difference)
    lines = []
    for ahead, what in ((mean - half > 0, "helps"), (mean + half < 0, "harms")):
        at = [int(n) for n, is_ahead in zip(flights, ahead, strict=True) if is_ahead]
        if at:
            lines.append(f"the prior {what} (95 % interval of the paired difference beyond 0) after {_listed(at)} flights")
    if not lines:
        lines.append("no number of flights shows a difference between prior and none (95 % intervals of the paired difference)")
    needed = [
        next((int(n) for n, s in zip(flights, curve.mean(0), strict=True) if s >= good), None) for curve in (prior, nothing)
    ]
    told = [f"not within {flights[-1]} flights" if n is None else f"after {n}" for n in needed]
    lines.append(f"mean score {good:g}: {told[0]} with the prior, {told[1]} without")
    return lines


def _listed(numbers: list[int]) -> str:
    return ", ".join(str(n) for n in numbers)
