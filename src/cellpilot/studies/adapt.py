"""From one map to another network: prepared on map A, deployed where the unknown truth is map B (`cellpilot adapt`).

Every arm flies the same random start-goal pairs of a seed in B, and is scored after some of these flights on all pairs
of B: 0 = greedy baseline, 1 = exact optimum.
"""

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, return_mean, score
from cellpilot.evaluate.summary import Summary
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.policies import GreedyPolicy, OptimalPolicy, Policy
from cellpilot.provenance import digest
from cellpilot.storage import load_array, save_array

if TYPE_CHECKING:
    import xarray as xr

from cellpilot.studies.adapt_arms import ARMS, LABELS, PRIOR_KERNEL, Transfer

CHECKPOINTS = (0, 1, 2, 3, 5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 300, 500, 700, 1_000, 2_000, 5_000, 10_000)
"""Numbers of flights after which policies are scored."""


def checkpoints_up_to(flights: int) -> list[int]:
    """Numbers of flights after which policies are scored, the last one among them."""
    return [*(n for n in CHECKPOINTS if n < flights), flights]


ADAPT_FIGURES = ("score", "reached_share", "path_ratio_p90")
"""What is kept of each policy."""


def adaptation(
    transfer: Transfer,
    flights: int,
    n_seeds: int,
    arms: Sequence[str] = tuple(ARMS),
    progress: Callable[[float], None] = lambda share: None,
    folder: Path | None = None,
) -> "xr.Dataset":
    """`ADAPT_FIGURES` over `(arm, seed, flights)`, on all pairs of the true map.

    With a `folder`, every finished curve is kept there, and one that is there need not be flown again.
    """
    import xarray as xr

    world, task = transfer.truth, transfer.task
    policies = GreedyPolicy(world), OptimalPolicy(world, task), OptimalPolicy(transfer.prepared, task)
    greedy, optimal, optimal_of_a = (exhaustive_summary(None, world, task, policy) for policy in policies)
    if score(greedy, greedy, optimal) is None:
        raise InputError("on map B the optimum is no better than the shortest path: choose a threshold that part of it misses")
    checkpoints = checkpoints_up_to(flights)
    found = np.empty((len(ADAPT_FIGURES), len(arms), n_seeds, len(checkpoints)))
    for i, seed in enumerate(range(n_seeds)):
        for j, name in enumerate(arms):
            within = lambda share, i=i, j=j: progress((i * len(arms) + j + share) / (n_seeds * len(arms)))
            file = None if folder is None else folder / f"{name}-{seed}-{_mark(transfer, checkpoints)}.npy"
            curve = load_array(file) if file is not None and file.is_file() else None
            if curve is None:
                curve = _curve(transfer, name, seed, checkpoints, greedy, optimal, within)
                if file is not None:
                    save_array(curve, file)
            found[:, j, i] = curve
            within(1.0)
    dims = ("arm", "seed", "flights")
    return xr.Dataset(
        {name: (dims, found[i], {"units": "1"}) for i, name in enumerate(ADAPT_FIGURES)},
        coords={"arm": list(arms), "seed": np.arange(n_seeds), "flights": checkpoints},
        attrs={
            "threshold_db": task.threshold_db,
            "noise_std_db": world.signal.noise_std_db,
            "greedy_return": return_mean(greedy),
            "optimal_return": return_mean(optimal),
            "score_of_optimum_of_a": score(optimal_of_a, greedy, optimal),
            "labels": json.dumps({name: LABELS[name] for name in arms}),
        }
        | likeness(transfer),
    )


def _curve(
    transfer: Transfer,
    arm: str,
    seed: int,
    checkpoints: Sequence[int],
    greedy: Summary,
    optimal: Summary,
    progress: Callable[[float], None],
) -> np.ndarray:
    """`ADAPT_FIGURES` of one arm and seed `[figures, checkpoints]`; NaN where there is none."""
    columns: list[list[float]] = []
    scored: Policy | None = None
    for policy in ARMS[arm](transfer, seed, checkpoints):
        if policy is not scored:
            found = exhaustive_summary(None, transfer.truth, transfer.task, policy)
            row = (score(found, greedy, optimal), *(METRICS[name].compute(found) for name in ADAPT_FIGURES[1:]))
            scored = policy
        columns.append([np.nan if value is None else value for value in row])
        progress(len(columns) / len(checkpoints))
    return np.array(columns).T


def _mark(transfer: Transfer, checkpoints: Sequence[int]) -> str:
    """Names everything a curve depends on besides arm and seed."""
    truth, prepared = transfer.truth, transfer.prepared
    text = repr((transfer.task, truth.signal.noise_std_db, truth.grid, PRIOR_KERNEL, MapLearning(), transfer.deep, checkpoints))
    return digest([truth.signal.mean_db, truth.airspace.reason, prepared.signal.mean_db, np.frombuffer(text.encode(), np.uint8)])


def likeness(transfer: Transfer) -> dict[str, float]:
    """How like A is to B in the free cells: correlation of SINR (NaN for a map without pattern), mean of A minus mean of B
    [dB], and shares of cells: both or neither below the threshold, A below it, B below it.
    """
    free = transfer.truth.airspace.free_cells
    a_db, b_db = (world.signal.mean_db[free].astype(np.float64) for world in (transfer.prepared, transfer.truth))
    low_a, low_b = a_db < transfer.task.threshold_db, b_db < transfer.task.threshold_db
    flat = a_db.std() == 0 or b_db.std() == 0
    return {
        "correlation": np.nan if flat else float(np.corrcoef(a_db, b_db)[0, 1]),
        "level_difference_db": float(a_db.mean() - b_db.mean()),
        "threshold_agreement": float((low_a == low_b).mean()),
        "low_share_a": float(low_a.mean()),
        "low_share_b": float(low_b.mean()),
    }
