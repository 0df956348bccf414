"""A ladder of tasks with known Q*, each rung one more thing that a learner must get right.

All rungs lie in one 5 x 5 grid whose other cells are blocked, so that one compilation serves them all.
"""

from collections.abc import Iterable
from functools import cache

import numpy as np
import pytest

from cellpilot.airspace import Airspace
from cellpilot.evaluate import evaluate_policies
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, PolicyParameters
from cellpilot.signal import Signal
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

SIDE = 5
TASK = Task(discount=0.9, max_steps=30)
SETTINGS = DDQNHER(
    episodes=1_500,
    batch_size=64,
    replay_capacity=20_000,
    replay_start=1_000,
    updates_per_episode=40,
    target_period=5,
    learning_rate=2e-3,
    final_exploration=0.5,
    hindsight_ratio=4,
    hidden_layers=2,
    hidden_units=64,
)


def rung(nx: int, ny: int, bad: Iterable[tuple[int, int]] = ()) -> World:
    """The south-western corner of nx x ny cells, some of them bad, is free."""
    grid = Grid(*(tuple(20.0 * i for i in range(n)) for n in (SIDE, SIDE, 1)))
    blocked, sinr_db = np.ones((SIDE, SIDE), bool), np.full((SIDE, SIDE), 10.0, np.float32)
    blocked[:ny, :nx] = False
    for x, y in bad:
        sinr_db[y, x] = -5.0
    return World(Airspace.of_blocked(grid, blocked.ravel()), Signal(sinr_db.ravel()))


RUNGS: dict[str, tuple[World, int, float]] = {  # world, episodes, and how far values may be from the exact ones
    "one step": (rung(2, 1), 300, 0.3),
    "two steps": (rung(3, 1), 300, 0.3),
    "corridor": (rung(5, 1), 600, 0.5),
    "3 x 3 with a bad cell": (rung(3, 3, [(1, 1)]), 900, 0.9),
    "5 x 5 with a bad wall": (rung(5, 5, [(2, 1), (2, 2), (2, 3)]), 1_500, np.inf),
}
CHUNK = 300


@cache
def learned(name: str) -> PolicyParameters:
    world, episodes, _ = RUNGS[name]
    chunks = iter(range(episodes // CHUNK))
    result = train_one(SETTINGS, Place(world, TASK), seed=0, chunk_rounds=CHUNK, interrupted=lambda: next(chunks, None) is None)
    assert int(result.state.episode) == episodes
    return result.policy_parameters({})


@pytest.mark.parametrize("name", list(RUNGS)[:-1])
def test_learned_values_are_the_exact_ones(name: str) -> None:
    world, _, tolerance = RUNGS[name]
    goals = world.airspace.free_cells
    found, exact = learned(name).values(world.grid, goals), optimal_values(world, TASK, goals)
    flown = ~world.airspace.blocked[:, None] & (np.arange(world.grid.n_cells)[:, None] != goals)
    assert np.abs(found - exact)[flown].max() < tolerance
    taken = np.take_along_axis(exact, found.argmax(-1)[..., None], -1)[..., 0]
    np.testing.assert_allclose(taken[flown], exact.max(-1)[flown], atol=1e-6)  # arg max is one of the best actions


def test_the_highest_rung_returns_what_the_optimum_does() -> None:
    name = "5 x 5 with a bad wall"
    world = RUNGS[name][0]
    policies = [GreedyPolicy(world), OptimalPolicy(world, TASK), LearnedPolicy(learned(name), world.grid)]
    table = evaluate_policies(world, TASK, policies, seed=0, n_sampled=10).policies
    assert table["learned/argmax"]["return_mean"] >= 0.99 * table["optimal"]["return_mean"]
    assert table["greedy"]["return_mean"] < 0.99 * table["optimal"]["return_mean"]  # else the rung would prove nothing
