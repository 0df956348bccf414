"""The fast figures of deterministic policies against flights that are flown step by step."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.evaluate import METRICS
from cellpilot.evaluate.exact import GOALS_AT_ONCE, exhaustive_summary, fly_all
from cellpilot.evaluate.flights import Departures, draw_flights
from cellpilot.evaluate.instances import all_pairs
from cellpilot.evaluate.metrics import reached_share, return_mean, score
from cellpilot.evaluate.summary import Summary, summarise
from cellpilot.policies import GreedyPolicy, OptimalPolicy
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


def flown(world: World, task: Task, policy: TablePolicy) -> Summary:
    """The sums of flights flown step by step, in expectation over noise; all goals at once, so that the draws are the same."""
    goals = world.airspace.free_cells
    start, goal = all_pairs(world, goals)
    column = np.searchsorted(goals, goal)
    drawn = draw_flights(
        np.random.default_rng(0), world, task, Departures(policy.action_probabilities(goals), goals, start, column)
    )
    return summarise(*drawn, world, task, expected=True)


@settings(max_examples=30)
@given(
    st.integers(0, 2**31),
    st.sampled_from([(5, 4, 1), (3, 3, 3), (7, 6, 1)]),
    st.sampled_from([0.0, 0.3]),
    st.sampled_from([0.0, 2.0]),
    st.sampled_from([0.05, 0.4, 1.0]),
    st.sampled_from([1, 3, 6, 20, 32, 33, 400]),
)
def test_they_equal_the_sums_of_all_flights(
    random_world: MakeWorld, seed: int, sides: tuple[int, int, int], blocked: float, noise: float, errors: float, cap: int
) -> None:
    world = random_world(seed, sides, blocked, noise, 1.0 if noise else 0.0)
    task = replace(TASK, max_steps=cap)
    policy = erring_policy(world, seed, errors)
    expected = flown(world, task, policy)
    found = exhaustive_summary(np.random.default_rng(0), world, task, policy)
    for name in ("n_flights", "n_steps", "arrivals", "steps_by_height"):
        np.testing.assert_array_equal(getattr(found, name), getattr(expected, name), err_msg=name)
    for name in ("return_sum", "low_steps", "sinr_histogram"):
        np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-9, atol=1e-9, err_msg=name)
    if len(world.airspace.free_cells) <= GOALS_AT_ONCE:  # one block of goals: the same draws
        np.testing.assert_array_equal(found.outages, expected.outages)
    assert found.outages.sum() == found.n_flights
    assert not exhaustive_summary(None, world, task, policy).outages.any()


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.sampled_from([0.1, 0.6]), st.sampled_from([7, 20]))
def test_every_pair_equals_its_own_flight(random_world: MakeWorld, seed: int, errors: float, cap: int) -> None:
    world = random_world(seed, (5, 4, 2), 0.2, 1.0)
    task, policy = replace(TASK, max_steps=cap), erring_policy(world, seed, errors)
    goals = world.airspace.free_cells[::-1]
    start, goal = all_pairs(world, goals)
    column = np.array([np.flatnonzero(goals == g)[0] for g in goal])
    probabilities = policy.action_probabilities(goals)
    records, visits = draw_flights(np.random.default_rng(0), world, task, Departures(probabilities, goals, start, column))
    departures = np.zeros((world.grid.n_cells, len(goals)))
    departures[start, column] = 1.0
    n_steps, reached, left = fly_all(world, task, probabilities.argmax(-1), goals, departures)
    np.testing.assert_array_equal(n_steps[start, column], records.n_steps)
    np.testing.assert_array_equal(reached[start, column], records.reached)
    assert left.sum() == visits.by_cell.sum()


def test_a_flight_that_circles_hits_the_cap_and_pays_for_it(make_world: MakeWorld) -> None:
    """On a corridor of three cells everybody flies east: towards the west end nobody arrives."""
    world = make_world((3, 1, 1), [10.0, 10.0, -10.0])
    policy = TablePolicy(world, np.full((3, 3), 2))
    found = exhaustive_summary(None, world, Task(max_steps=13), policy, goals=np.array([0]))
    # From the middle and from the east end: 13 steps each, all in the bad east cell.
    assert found.n_flights == 2
    assert reached_share(found) == 0
    assert METRICS["low_sinr_share"].compute(found) == 1
    assert return_mean(found) == pytest.approx(-1.1 * 13)
    assert METRICS["path_ratio_p90"].compute(found) is None


@pytest.mark.parametrize("cap", [1, 2, 5])
def test_a_flight_that_ends_in_a_blocked_cell_is_over_and_has_not_reached(make_world: MakeWorld, cap: int) -> None:
    """A corridor of five cells, the middle one blocked, rule `end`: whoever flies east from the west end enters it."""
    world = make_world((5, 1, 1), 10.0, blocked=[(2, 0, 0)], rule="end")
    task = Task(rho_goal=7.0, rho_sinr=0.0, rho_step=-0.25, rho_end=-4.0, max_steps=cap)
    found = exhaustive_summary(None, world, task, TablePolicy(world, np.full((5, 5), 2)), (1, 0, 0), (0, 0, 0))
    assert (found.n_flights, found.n_steps, reached_share(found)) == (1, 1, 0)
    assert found.return_sum == pytest.approx(-4.25)


def test_the_score_of_baseline_and_optimum(random_world: MakeWorld) -> None:
    world = random_world(3, (6, 6, 1), 0.1)
    greedy, optimal = (
        exhaustive_summary(None, world, TASK, p) for p in (GreedyPolicy(world), OptimalPolicy.undiscounted(world, TASK))
    )
    assert score(greedy, greedy, optimal) == 0
    assert score(optimal, greedy, optimal) == 1
    assert score(greedy, greedy, greedy) is None
    between = replace(greedy, return_sum=(3 * greedy.return_sum + optimal.return_sum) / 4)
    assert score(between, greedy, optimal) == pytest.approx(0.25)


def test_what_cannot_be_computed_is_refused(make_world: MakeWorld) -> None:
    world = make_world((3, 2, 1), blocked=[(1, 0, 0), (1, 1, 0)])
    with pytest.raises(ValueError, match="no start"):
        exhaustive_summary(None, world, TASK, GreedyPolicy(world), goals=np.array([], np.int32))


def test_goals_in_several_blocks_add_up(random_world: MakeWorld) -> None:
    world = random_world(5, (9, 9, 1), 0.1, 1.0)
    policy = erring_policy(world, 5, 0.1)
    whole = exhaustive_summary(None, world, TASK, policy)
    parts = [exhaustive_summary(None, world, TASK, policy, goals=goal[None]) for goal in world.airspace.free_cells]
    assert whole.n_flights == sum(part.n_flights for part in parts)
    assert whole.return_sum == pytest.approx(sum(part.return_sum for part in parts))
