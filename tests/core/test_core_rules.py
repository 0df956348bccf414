"""The three rules for a forbidden move, on a world of 3 x 3 cells, with values worked out by hand."""

from collections.abc import Callable

import numpy as np
import pytest

from cellpilot.airspace import BORDER, ENTERED, MASKED, MOVE_SETS, MOVED, STOPPED, Airspace, Reason
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.solve import optimal_values
from cellpilot.task import Price, Task, Transition
from cellpilot.world import World

MakeWorld = Callable[..., World]
NORTH, SOUTH, EAST, WEST = range(4)
TASK = Task(rho_goal=10.0, rho_sinr=-1.0, rho_step=-0.5, rho_blocked=-2.0, rho_end=-20.0, discount=0.9, max_steps=30)
MIDDLE = [(1, 1, 0)]


@pytest.mark.parametrize(
    ("rule", "into_the_middle", "over_the_border"),
    [("stay", (3, STOPPED), (3, BORDER)), ("mask", (3, MASKED), (3, MASKED)), ("end", (4, ENTERED), (3, BORDER))],
)
def test_what_becomes_of_a_move(
    make_world: MakeWorld, rule: str, into_the_middle: tuple[int, int], over_the_border: tuple[int, int]
) -> None:
    airspace = make_world((3, 3, 1), blocked=MIDDLE, rule=rule).airspace
    found = [tuple(int(x) for x in airspace.step(3, action)) for action in (NORTH, EAST, WEST)]
    assert found == [(6, MOVED), into_the_middle, over_the_border]
    np.testing.assert_array_equal(airspace.offered[3], [True, True, rule != "mask", rule != "mask"])


AROUND = -0.5 * (1 + 0.9 + 0.81 + 0.729) + 0.729 * 10.0
"""Value of (0, 1) for the goal (2, 1): four steps around the middle, 5.5705."""


@pytest.mark.parametrize(
    ("rule", "east", "west"),
    [
        ("stay", -0.5 - 2.0 + 0.9 * AROUND, -0.5 + 0.9 * AROUND),  # stopped by the middle, kept by the border
        ("mask", -np.inf, -np.inf),
        ("end", -0.5 - 20.0, -0.5 + 0.9 * AROUND),
    ],
)
def test_values_by_hand(make_world: MakeWorld, rule: str, east: float, west: float) -> None:
    world = make_world((3, 3, 1), blocked=MIDDLE, rule=rule)
    values = optimal_values(world, TASK, np.array([5]))[3, 0]
    np.testing.assert_allclose(values, [AROUND, AROUND, east, west])


def test_a_flight_ends_in_a_blocked_cell_without_reaching_its_goal(make_world: MakeWorld) -> None:
    world = make_world((3, 3, 1), blocked=MIDDLE, rule="end")
    reward, reached, terminated = TASK.outcome(Transition(3, EAST, 4, np.float32(1.0), ENTERED), 5)
    assert (reward, bool(reached), bool(terminated)) == (-0.5 - 1.0 - 20.0, False, True)
    assert TASK.value_bounds(world.airspace.ends) == pytest.approx((-3.5 / 0.1 - 20.0, 10.0))
    assert TASK.value_bounds() == pytest.approx((-3.5 / 0.1, 10.0))


def test_ending_on_purpose_is_the_optimum_where_every_way_costs_more(make_world: MakeWorld) -> None:
    """A row of bad cells with a blocked one beside the start: the exact values weigh the penalty against the way."""
    world = make_world((6, 2, 1), -9.0, blocked=[(0, 1, 0)], rule="end")
    cheap, dear = (Task(rho_sinr=-3.0, rho_step=-0.1, rho_end=rho_end, discount=1.0) for rho_end in (-1.0, -100.0))
    assert optimal_values(world, cheap, np.array([5]))[0, 0].argmax() == NORTH
    assert optimal_values(world, dear, np.array([5]))[0, 0].argmax() == EAST


def test_diagonal_moves_do_not_cut_corners(make_world: MakeWorld) -> None:
    airspace = make_world((3, 3, 1), blocked=MIDDLE, n_moves=8).airspace
    names = dict(zip(airspace.moves.names, range(8), strict=True))
    assert names.keys() == {"north", "south", "east", "west", "north-east", "north-west", "south-east", "south-west"}
    assert airspace.step(1, names["north-east"])[1] == STOPPED  # from (1, 0) past the corner of (1, 1)
    assert airspace.step(0, names["north-east"])[1] == STOPPED  # into it
    np.testing.assert_array_equal(airspace.shortest_steps(np.array([8]))[[0, 2, 7]].ravel(), [4, 2, 1])


@pytest.mark.parametrize(("n_moves", "sides", "steps"), [(8, (4, 3, 1), 3), (26, (4, 3, 2), 3), (6, (4, 3, 2), 6)])
def test_steps_of_every_move_set(make_world: MakeWorld, n_moves: int, sides: tuple[int, int, int], steps: int) -> None:
    airspace = make_world(sides, n_moves=n_moves).airspace
    assert len(MOVE_SETS[n_moves]) == n_moves == airspace.n_actions
    last = np.array([airspace.grid.n_cells - 1])
    assert airspace.shortest_steps(last)[0, 0] == steps
    source, target, action = airspace.flown()
    np.testing.assert_array_equal(airspace.grid.position(target) - airspace.grid.position(source), airspace.moves.array[action])


def test_a_blocked_cell_keeps_its_reason() -> None:
    grid = Grid((0.0, 10.0, 20.0), (0.0,), (30.0,))
    reasons = Reason("airport"), Reason("building", "houses.geojson")
    airspace = Airspace(grid, np.array([0, 0, 2], np.uint8), reasons)
    assert airspace.reason_of(2) == reasons[1]
    assert airspace.reason_of(0) is None
    with pytest.raises(InputError, match=r"goal .* lies in a blocked cell \(building, houses\.geojson\)"):
        airspace.start_goal_cells(None, (2, 0, 0))
    with pytest.raises(InputError, match="at most 1"):
        Airspace(grid, np.array([0, 0, 2], np.uint8), reasons[:1])


def test_a_reward_of_ones_own_is_one_price(make_world: MakeWorld) -> None:
    """A price of climbing: the optimum stays low, and outcome and expectation have it alike."""
    climb = Price("climb", -3.0, "move", lambda move: move.action == 4)
    world = make_world((3, 1, 2), [5.0, -9.0, 5.0, 9.0, 9.0, 9.0])
    plain, priced = Task(rho_sinr=-2.0, discount=1.0), Task(rho_sinr=-2.0, discount=1.0, more=(climb,))
    best = [optimal_values(world, task, np.array([2]))[0, 0].argmax() for task in (plain, priced)]
    assert [world.airspace.moves.names[action] for action in best] == ["up", "east"]
    drawn = priced.outcome(Transition(0, 4, 3, np.float32(9.0), MOVED), 2).reward
    assert drawn == priced.expected_outcome(world, 0, 4, 2).reward == pytest.approx(-3.1)
    assert priced.value_bounds() == (-np.inf, 10.0)
