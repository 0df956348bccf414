"""The fast figures of deterministic policies against flights that are flown step by step."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.evaluate import METRICS
from cellpilot.evaluate.deterministic import DeterministicFigures, deterministic_figures, score
from cellpilot.evaluate.evaluation import exhaustive_summary
from cellpilot.evaluate.flights import fly
from cellpilot.evaluate.instances import all_pairs
from cellpilot.policies import GreedyPolicy, OptimalPolicy, RandomPolicy
from cellpilot.policies.base import one_hot
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
TASK = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-0.5, threshold_db=2.0, max_steps=20)


class TablePolicy:
    """Actions from a table `[n_cells, goals]`."""

    name = "table"
    deterministic = True

    def __init__(self, world: World, actions: np.ndarray):
        self.world, self.table = world, actions

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        return one_hot(self.table[:, goals].astype(np.int8), self.world.airspace.n_actions)


def erring_policy(world: World, seed: int, error_share: float) -> TablePolicy:
    """Shortest paths with random errors: some flights arrive, some loop until the cap, some bump into blocked cells."""
    n, rng = world.grid.n_cells, np.random.default_rng(seed)
    shortest = GreedyPolicy(world).action_probabilities(np.arange(n, dtype=np.int32)).argmax(-1)
    wrong = rng.random((n, n)) < error_share
    return TablePolicy(world, np.where(wrong, rng.integers(0, world.airspace.n_actions, (n, n)), shortest))


@settings(max_examples=30)
@given(
    st.integers(0, 2**31),
    st.sampled_from([(5, 4, 1), (3, 3, 3), (7, 6, 1)]),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([0.05, 0.4, 1.0]),
    st.sampled_from([1, 3, 6, 20, 32, 33, 400]),
)
def test_they_equal_the_exhaustive_summary(
    random_world: MakeWorld, seed: int, sides: tuple[int, int, int], blocked: float, noise: float, errors: float, cap: int
) -> None:
    world = random_world(seed, sides, blocked, noise, 1.0 if noise else 0.0)
    task = replace(TASK, max_steps=cap)
    policy = erring_policy(world, seed, errors)
    found = deterministic_figures(world, task, policy)
    expected = exhaustive_summary(np.random.default_rng(0), world, task, policy)
    assert found.n_pairs == expected.n_flights
    assert found.n_steps_mean * found.n_pairs == pytest.approx(expected.n_steps, rel=1e-12)
    for name in ("return_mean", "reached_share", "low_sinr_share", "path_ratio_mean", "path_ratio_p50", "path_ratio_p90"):
        assert getattr(found, name) == pytest.approx(METRICS[name].compute(expected), rel=1e-9), name


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.sampled_from([0.1, 0.6]), st.sampled_from([7, 20]))
def test_every_pair_equals_its_own_flight(random_world: MakeWorld, seed: int, errors: float, cap: int) -> None:
    world = random_world(seed, (5, 4, 2), 0.2, 1.0)
    task, policy = replace(TASK, max_steps=cap), erring_policy(world, seed, errors)
    goals = world.airspace.free_cells[::-1]
    pairs = deterministic_figures(world, task, policy, goals, per_pair=True).pairs
    assert pairs is not None
    np.testing.assert_array_equal(pairs.goals, goals)
    start, goal = all_pairs(world, goals)
    column = np.array([np.flatnonzero(goals == g)[0] for g in goal])
    flown, _ = fly(np.random.default_rng(0), world, task, policy.action_probabilities(goals), goals, start, column)
    assert pairs.valid.sum() == len(start)
    assert pairs.valid[start, column].all()
    np.testing.assert_array_equal(pairs.n_steps[start, column], flown.n_steps)
    np.testing.assert_array_equal(pairs.reached[start, column], flown.reached)
    np.testing.assert_allclose(pairs.expected_return[start, column], flown.expected_return, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(pairs.expected_low_steps[start, column], flown.expected_low_steps, rtol=1e-9, atol=1e-9)


def test_a_flight_that_circles_hits_the_cap_and_pays_for_it(make_world: MakeWorld) -> None:
    """On a corridor of three cells everybody flies east: towards the west end nobody arrives."""
    world = make_world((3, 1, 1), [10.0, 10.0, -10.0])
    policy = TablePolicy(world, np.full((3, 3), 2))
    found = deterministic_figures(world, Task(max_steps=13), policy, np.array([0]))
    # From the middle and from the east end: 13 steps each, all in the bad east cell.
    assert found.n_pairs == 2
    assert found.reached_share == 0
    assert found.low_sinr_share == 1
    assert found.return_mean == pytest.approx(-1.1 * 13)
    assert found.path_ratio_p90 is None


def test_the_score_of_baseline_and_optimum(random_world: MakeWorld) -> None:
    world = random_world(3, (6, 6, 1), 0.1)
    greedy, optimal = (
        deterministic_figures(world, TASK, p) for p in (GreedyPolicy(world), OptimalPolicy.undiscounted(world, TASK))
    )
    assert score(greedy, greedy, optimal) == 0
    assert score(optimal, greedy, optimal) == 1
    assert score(greedy, greedy, greedy) is None
    between = replace(greedy, return_mean=(3 * greedy.return_mean + optimal.return_mean) / 4)
    assert score(between, greedy, optimal) == pytest.approx(0.25)


def test_what_cannot_be_computed_is_refused(make_world: MakeWorld) -> None:
    world = make_world((3, 2, 1), blocked=[(1, 0, 0), (1, 1, 0)])
    with pytest.raises(ValueError, match="not deterministic"):
        deterministic_figures(world, TASK, RandomPolicy(world))
    with pytest.raises(ValueError, match="no start"):
        deterministic_figures(world, TASK, GreedyPolicy(world), np.array([], np.int32))


def test_goals_in_several_blocks_add_up(random_world: MakeWorld) -> None:
    world = random_world(5, (9, 9, 1), 0.1, 1.0)
    policy = erring_policy(world, 5, 0.1)
    whole = deterministic_figures(world, TASK, policy)
    parts: list[DeterministicFigures] = [
        deterministic_figures(world, TASK, policy, goal[None]) for goal in world.airspace.free_cells
    ]
    assert whole.n_pairs == sum(part.n_pairs for part in parts)
    assert whole.return_mean * whole.n_pairs == pytest.approx(sum(part.return_mean * part.n_pairs for part in parts))
