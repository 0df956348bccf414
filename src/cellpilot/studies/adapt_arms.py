"""The arms of `cellpilot adapt`: what is known of map A, and how each goes on in the unknown network B."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner import learn_map
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.maps.estimate.gaussian_process import Kernel
from cellpilot.policies import Policy
from cellpilot.task import Task
from cellpilot.world import World

if TYPE_CHECKING:
    from cellpilot.learn.algorithms.fqi_her import FittedState


@dataclass(frozen=True, eq=False)
class Transfer:
    """What there is before the first flight, and the truth that only measurements show."""

    task: Task
    prepared: World  # map A on the grid of B; it may be wrong everywhere
    truth: World  # map B, without uncertainty
    deep: FQIHER  # how the deep policy is trained on map A


Arm = Callable[[Transfer, int, Sequence[int]], Iterator[Policy]]
"""(transfer, seed, checkpoints) -> its deterministic policy after each number of flights, which are increasing."""
PRIOR_KERNEL = Kernel(offset_std_db=5.0, height_offset_std_db=2.0)
"""A prior map knows the level better than nothing does."""


def _map_with_prior(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    known_db = transfer.prepared.signal.mean_db.astype(np.float64)
    for learner in learn_map(transfer.truth, transfer.task, MapLearning(), seed, checkpoints, known_db, PRIOR_KERNEL):
        yield learner.policy()


def _map_from_nothing(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    for learner in learn_map(transfer.truth, transfer.task, MapLearning(), seed, checkpoints):
        yield learner.policy()


@lru_cache(maxsize=1)
def _trained(transfer: Transfer, seed: int) -> "FittedState":
    """FQI-HER trained on map A, once for both arms that fly it, which follow each other."""
    from cellpilot.learn.algorithms.fqi_her_online import train_beforehand

    return train_beforehand(transfer.deep, transfer.prepared, transfer.task, seed)


def _frozen(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    from cellpilot.learn.algorithms.fqi_her_online import argmax_policy

    policy = argmax_policy(_trained(transfer, seed), transfer.deep, transfer.truth.grid, transfer.task)
    yield from [policy] * len(checkpoints)


def _online(transfer: Transfer, seed: int, checkpoints: Sequence[int]) -> Iterator[Policy]:
    from cellpilot.learn.algorithms.fqi_her_online import learn_online

    yield from learn_online(_trained(transfer, seed), transfer.deep, transfer.truth, transfer.task, seed, checkpoints)


PRIOR, NOTHING, FROZEN, ONLINE = "map-prior", "map-nothing", "deep-frozen", "deep-online"
ARMS: dict[str, Arm] = {PRIOR: _map_with_prior, NOTHING: _map_from_nothing, FROZEN: _frozen, ONLINE: _online}
LABELS = {
    PRIOR: "map learner, A as prior",
    NOTHING: "map learner from nothing",
    FROZEN: "deep policy of A, frozen",
    ONLINE: "deep policy of A, learns on",
}
