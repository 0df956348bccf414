"""How well a method fills holes: whole blocks of the map are hidden, at all heights, and the estimate there is compared.

Hiding single cells would flatter every method: neighbours along a flight line are a few metres away, across a hole they are not.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.estimate.methods import Estimate, Known, Method

INTERVAL_STD = 1.959964
"""Half of a 95 % interval in standard deviations."""


class HoldOut(NamedTuple):
    """Errors of one method, means over the splits in which it says anything; NaN if there is none."""

    rmse_db: float
    mae_db: float
    coverage: float  # share of hidden cells within the method's 95 % interval
    answered: float  # share of hidden cells the method says anything of


def block_holdout(
    known: Known,
    methods: Mapping[str, Method],
    block_m: float = 60.0,
    hidden_share: float = 0.2,
    splits: int = 10,
    seed: int = 0,
    progress: Callable[[float], None] = lambda share: None,
) -> dict[str, HoldOut]:
    """Root mean square and mean absolute error [dB], and interval coverage of each method over hidden blocks.

    In each split a share of the blocks of `block_m` x `block_m` that hold measurements is hidden at all heights. Errors are those
    of cell means; the interval counts the noise of a hidden cell's own samples. `InputError` for fewer than 5 blocks.
    """
    block = np.floor(known.points_m[:, :2] / block_m)
    blocks, number = np.unique(block, axis=0, return_inverse=True)
    n_hidden = round(hidden_share * len(blocks))
    if n_hidden < 1 or len(blocks) < 5:
        raise InputError(
            f"the measurements fill {len(blocks)} block(s) of {block_m:g} m; a hold-out check needs at least 5:"
            " use smaller blocks or cells, or a longer log"
        )
    rows: dict[str, list[HoldOut]] = {name: [] for name in methods}
    for split in range(splits):
        hidden_blocks = np.random.default_rng([seed, split]).permutation(len(blocks))[:n_hidden]
        hidden = np.isin(number.ravel(), hidden_blocks)
        seen = Known(*(values[~hidden] for values in known))
        for i, (name, method) in enumerate(methods.items()):
            rows[name].append(_errors(known, hidden, method(seen, known.points_m[hidden], known.prior_db[hidden])))
            progress((split + (i + 1) / len(methods)) / splits)
    return {name: _mean(results) for name, results in rows.items()}


def _mean(results: list[HoldOut]) -> HoldOut:
    told = [result for result in results if result.answered] or results
    rmse_db, mae_db, coverage, _ = np.mean(told, axis=0).tolist()
    return HoldOut(rmse_db, mae_db, coverage, float(np.mean([result.answered for result in results])))


def _errors(known: Known, hidden: NDArray[np.bool_], estimate: Estimate) -> HoldOut:
    mean_db, std_db, noise_std_db, _ = estimate
    error_db = mean_db - known.mean_db[hidden]
    told = ~np.isnan(error_db)
    total_std_db = np.sqrt(std_db**2 + noise_std_db**2 / known.n_samples[hidden])
    within = np.abs(error_db[told]) <= INTERVAL_STD * total_std_db[told]
    if not told.any():
        return HoldOut(np.nan, np.nan, np.nan, 0.0)
    return HoldOut(
        float(np.sqrt(np.mean(error_db[told] ** 2))),
        float(np.abs(error_db[told]).mean()),
        float(within.mean()),
        float(told.mean()),
    )
