from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.policies import GreedyPolicy, RandomPolicy, greedy_actions
from cellpilot.world import World

MakeWorld = Callable[..., World]
NORTH, SOUTH, EAST, WEST, UP, DOWN = range(6)


def action_towards(world: World, start: tuple[int, int, int], goal: tuple[int, int, int]) -> int:
    probabilities = GreedyPolicy(world).action_probabilities(world.grid.cell(goal).reshape(1))
    return int(probabilities[world.grid.cell(start), 0].argmax())


@pytest.mark.parametrize(
    ("goal", "action"),
    [
        ((2, 5, 2), NORTH),
        ((2, 0, 2), SOUTH),
        ((5, 2, 2), EAST),
        ((0, 2, 2), WEST),
        ((2, 2, 4), UP),
        ((2, 2, 0), DOWN),
        ((3, 4, 2), NORTH),  # the longest axis first
        ((4, 3, 2), EAST),
        ((3, 1, 0), DOWN),
        ((4, 4, 4), EAST),  # ties: x before y before z
        ((0, 0, 0), WEST),
        ((2, 4, 4), NORTH),
        ((2, 0, 0), SOUTH),
        ((3, 3, 2), EAST),
        ((1, 3, 3), WEST),
    ],
)
def test_the_longest_axis_first(make_world: MakeWorld, goal: tuple[int, int, int], action: int) -> None:
    assert action_towards(make_world((6, 6, 5)), (2, 2, 2), goal) == action


def test_a_whole_flight_of_the_baseline(make_world: MakeWorld) -> None:
    """(0, 0) to (3, 1): east until both axes are equally long, then x before y."""
    world = make_world((4, 4, 1))
    goal = world.grid.cell((3, 1, 0)).reshape(1)
    best = GreedyPolicy(world).action_probabilities(goal)[:, 0].argmax(-1)
    cell, route = 0, []
    while cell != goal[0]:
        route.append(int(best[cell]))
        cell = int(world.airspace.next_cell[cell, best[cell]])
    assert route == [EAST, EAST, EAST, NORTH]


@settings(max_examples=25)
@given(st.integers(0, 2**31), st.sampled_from([(5, 5, 1), (3, 3, 3), (6, 3, 1)]), st.sampled_from([0.0, 0.2, 0.4]))
def test_every_goal_is_reached_on_a_shortest_allowed_path(
    random_world: MakeWorld, plain: Callable, seed: int, sides: tuple[int, int, int], share: float
) -> None:
    world = random_world(seed, sides, share)
    reference = plain(world)
    goals = world.airspace.free_cells
    probabilities = GreedyPolicy(world).action_probabilities(goals)
    assert set(np.unique(probabilities)) <= {0.0, 1.0}
    np.testing.assert_array_equal(probabilities.sum(-1), 1.0)
    best = probabilities.argmax(-1)
    for column, goal in enumerate(goals):
        target = reference.positions[goal]
        distances = reference.distances(target)
        for position, steps in distances.items():
            for _ in range(steps):
                position, _stopped = reference.step(position, int(best[reference.cell(position), column]))
            assert position == target


def test_the_random_policy_is_uniform(make_world: MakeWorld) -> None:
    for sides, actions in (((3, 3, 1), 4), ((3, 3, 2), 6)):
        world = make_world(sides)
        probabilities = RandomPolicy(world).action_probabilities(world.airspace.free_cells)
        assert probabilities.shape == (world.grid.n_cells, world.grid.n_cells, actions)
        np.testing.assert_allclose(probabilities, 1 / actions)


def test_ties_go_to_the_lowest_action() -> None:
    values = np.array([[1.0, 2.0, 2.0, 0.0], [3.0, 3.0 + 1e-12, 0.0, 3.0], [0.0, 0.0, 0.0, 1e-3]])
    assert greedy_actions(values).tolist() == [1, 0, 3]
    assert greedy_actions(values, tolerance=0.0).tolist() == [1, 1, 3]
