import json
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.plan.route import LOOPS, REACHED, TIME_LIMIT, parse_place, plan_route, route_payload
from cellpilot.policies import GreedyPolicy, OptimalPolicy
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
NORTH, SOUTH, EAST, WEST = range(4)


class Fixed:
    """The same action everywhere, or one per cell."""

    name, deterministic = "fixed", True

    def __init__(self, world: World, actions: object):
        self.table = np.broadcast_to(np.asarray(actions), world.grid.n_cells)
        self.n_actions = world.airspace.n_actions

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        return np.repeat(np.eye(self.n_actions, dtype=np.float32)[self.table][:, None], len(goals), axis=1)


def test_a_route_that_reaches_the_goal_by_hand(make_world: MakeWorld) -> None:
    world = make_world((4, 1, 1), [-5.0, 9.0, -5.0, 3.0], noise_std_db=0.0)
    task = Task()
    route = plan_route(world, task, GreedyPolicy(world), (0, 0, 0), (3, 0, 0))
    assert (route.status, route.policy, route.n_steps, route.shortest_steps) == (REACHED, "greedy", 3, 3)
    assert route.cells.tolist() == [0, 1, 2, 3]
    assert route.sinr_db == (-5.0, 9.0, -5.0, 3.0)
    assert route.low_probability == (1.0, 0.0, 1.0, 0.0)
    assert route.length_m == pytest.approx(60.0)
    assert route.expected_return == pytest.approx(10.0 - 0.3 - 1.0)
    assert route.expected_low_share == pytest.approx(1 / 3)  # the start is not entered


@pytest.mark.parametrize("actions", [[EAST, WEST, EAST, EAST], [NORTH] * 4, [EAST, EAST, WEST, EAST]])
def test_a_route_that_loops_says_so(make_world: MakeWorld, actions: list[int]) -> None:
    world = make_world((4, 1, 1))
    route = plan_route(world, Task(), Fixed(world, actions), (0, 0, 0), (3, 0, 0))
    assert route.status == LOOPS
    assert route.cells[-1] in route.cells[:-1]
    assert len(set(route.cells[:-1].tolist())) == route.n_steps
    assert route.expected_return == pytest.approx(-0.1 * route.n_steps)
    assert route_payload(route, world)["path_ratio"] is None


def test_a_route_that_hits_the_time_limit_says_so(make_world: MakeWorld) -> None:
    world = make_world((6, 1, 1))
    for max_steps, status in ((4, TIME_LIMIT), (5, REACHED)):
        route = plan_route(world, Task(max_steps=max_steps), Fixed(world, EAST), (0, 0, 0), (5, 0, 0))
        assert (route.status, route.n_steps) == (status, max_steps)


@settings(max_examples=20)
@given(st.integers(0, 2**31), st.sampled_from([(5, 4, 1), (3, 3, 2)]))
def test_a_route_is_what_the_evaluation_flies(random_world: MakeWorld, seed: int, sides: tuple[int, int, int]) -> None:
    world = random_world(seed, sides, 0.2, 2.0)
    task = Task()
    start, goal = (tuple(p) for p in world.grid.position(world.airspace.free_cells[[0, 1]]).tolist())
    for policy in (OptimalPolicy(world, task), GreedyPolicy(world)):
        try:
            route = plan_route(world, task, policy, start, goal)
        except InputError:
            assert world.airspace.part[world.grid.cell(start)] != world.airspace.part[world.grid.cell(goal)]
            continue
        summary = exhaustive_summary(np.random.default_rng(0), world, task, policy, start, goal)
        assert route.status == REACHED
        assert route.expected_return == pytest.approx(summary.return_sum)
        assert route.n_steps == summary.n_steps
        assert route.expected_low_share == pytest.approx(summary.low_steps / summary.n_steps)
        assert summary.arrivals[route.n_steps, route.shortest_steps] == 1
        assert not world.airspace.blocked[route.cells].any()


def test_unusable_ends_are_refused(make_world: MakeWorld) -> None:
    world = make_world((5, 2, 1), blocked=[(2, 0, 0), (2, 1, 0)])
    cases = [
        ((0, 0, 0), (0, 0, 0), "both"),
        ((2, 0, 0), (0, 0, 0), "start"),
        ((0, 0, 0), (2, 1, 0), "goal"),
        ((0, 0, 0), (4, 0, 0), "no route"),
        ((0, 0, 0), (5, 0, 0), "goal"),
    ]
    for start, goal, message in cases:
        with pytest.raises(InputError, match=message):
            plan_route(world, Task(), GreedyPolicy(world), start, goal)


def test_unknown_signal_counts_as_low_and_is_written_as_none(make_world: MakeWorld) -> None:
    world = make_world((3, 1, 1), [5.0, -np.inf, 5.0])
    route = plan_route(world, Task(), GreedyPolicy(world), (0, 0, 0), (2, 0, 0))
    assert route.sinr_db == (5.0, None, 5.0)
    assert route.low_probability == (0.0, 1.0, 0.0)


def test_route_as_plain_data(make_world: MakeWorld) -> None:
    world = make_world((3, 2, 1), 5.0)
    route = plan_route(world, Task(), GreedyPolicy(world), (0, 0, 0), (2, 1, 0))
    payload = json.loads(json.dumps(route_payload(route, world, lambda x, y: (50.0 + y / 1e5, 7.0 + x / 1e5))))
    assert payload["status"] == "reached"
    assert (payload["n_steps"], payload["path_ratio"]) == (3, 1.0)
    assert [step["position"] for step in payload["steps"]] == [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0]]
    assert payload["steps"][3]["x_m"] == 50.0
    assert payload["steps"][3]["latitude_deg"] == pytest.approx(50.0003)
    assert "latitude_deg" not in route_payload(route, world)["steps"][0]


@pytest.fixture(scope="module")
def world(make_world: MakeWorld) -> World:
    """5 x 4 x 3 cells of 20 m, centres from 10 m."""
    return make_world((5, 4, 3))


@pytest.mark.parametrize(
    ("text", "position"),
    [
        ("3,2,1", (3, 2, 1)),
        (" 0 , 0,0", (0, 0, 0)),
        ("+4,3,2", (4, 3, 2)),
        ("10m,10m,10m", (0, 0, 0)),
        ("0m, 79.5m ,41m", (0, 3, 2)),
        ("99.9m,20.1m,3e1m", (4, 1, 1)),
        ("50.0003,7.0005,30", (2, 1, 1)),
        ("50.0003, 7.0005, 50.0", (2, 1, 2)),
    ],
)
def test_places_in_cells_metres_and_degrees(world: World, text: str, position: tuple[int, int, int]) -> None:
    to_local = lambda latitude, longitude: ((longitude - 7.0) * 1e5, (latitude - 50.0) * 1e5)
    assert parse_place(text, "start", world, to_local) == position


@pytest.mark.parametrize(
    "text",
    [
        "", "3", "3,2", "3,2,1,0", "a,b,c", "3,2,", "3,2,x", "10m,20m,", "m,m,m", "10m,20,30m", "1..2,3,4", "--1,2,3",
        "5,0,0", "0,4,0", "0,0,3", "-1,0,0", "101m,10m,10m", "10m,-1m,10m", "10m,10m,61m", "nanm,10m,10m", "infm,10m,10m",
        "90.5,7.0,30", "50.0,181.0,30", "nan,7.0,30", "50.0,nan,30", "50.1,7.0005,30", "50.0003,7.0005,300", "50.0003,7.0005,nan",
        "\u00b2,1,0", "50.0003;7.0005;30",
    ],
)  # fmt: skip
def test_wrong_places_name_what_is_wrong(world: World, text: str) -> None:
    to_local = lambda latitude, longitude: ((longitude - 7.0) * 1e5, (latitude - 50.0) * 1e5)
    with pytest.raises(InputError, match="start"):
        parse_place(text, "start", world, to_local)


def test_degrees_need_an_anchor(world: World) -> None:
    with pytest.raises(InputError, match=r"goal .* no anchor"):
        parse_place("50.0003,7.0005,30", "goal", world)


@pytest.mark.parametrize("text", ["10m,10m,infm", "10m,10m,-infm", "50.0003,7.0005,inf"])
def test_an_infinite_height_is_no_place_even_on_one_height(make_world: MakeWorld, text: str) -> None:
    to_local = lambda latitude, longitude: ((longitude - 7.0) * 1e5, (latitude - 50.0) * 1e5)
    with pytest.raises(InputError, match="start"):
        parse_place(text, "start", make_world((5, 4, 1)), to_local)


def test_a_long_route_does_not_circle_where_the_signal_is_good(make_world: MakeWorld) -> None:
    # At discount 0.995 a goal 600 steps away is worth less than the signal one loses on the way to it.
    sides = (600, 2, 1)
    sinr_db = np.full(1200, 10.0)
    sinr_db[20:600] = -5.0
    sinr_db[600 + 300 : 600 + 310] = -5.0
    world, task = make_world(sides, sinr_db), Task(max_steps=6020)
    discounted = plan_route(world, task, OptimalPolicy(world, task), (0, 0, 0), (599, 0, 0))
    route = plan_route(world, task, OptimalPolicy(world, task, 1.0), (0, 0, 0), (599, 0, 0))
    assert route.status == "reached"
    assert route.n_steps <= 603
    assert route.expected_low_share < 15 / 600
    assert discounted.status == "loops" or discounted.n_steps >= route.n_steps


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("2,1,0", (2, 1, 0)),
        ("2c,1c,0c", (2, 1, 0)),
        ("50m,30m,10m", (2, 1, 0)),
        ("60.0,25.0,10", (0, 0, 0)),
        ("60deg,25deg,10m", (0, 0, 0)),
        ("60.0004,25.0007,10.0", (2, 2, 0)),
    ],
)
def test_a_place_in_cells_metres_or_degrees(make_world: MakeWorld, text: str, expected: tuple[int, int, int]) -> None:
    world = make_world((4, 4, 1))
    to_local = lambda latitude_deg, longitude_deg: (10 + (longitude_deg - 25) * 55_000, 10 + (latitude_deg - 60) * 111_000)
    assert parse_place(text, "--start", world, to_local) == expected


def test_whole_numbers_that_are_a_place_on_the_map_too_are_asked_about(make_world: MakeWorld) -> None:
    world = make_world((70, 30, 1))
    to_local = lambda latitude_deg, longitude_deg: (10 + (longitude_deg - 25) * 55_000, 10 + (latitude_deg - 60) * 111_000)
    with pytest.raises(InputError, match=r"write 60c,25c,0c for the cell or 60deg,25deg,0m for the place"):
        parse_place("60,25,0", "--start", world, to_local)
    assert parse_place("60c,25c,0c", "--start", world, to_local) == (60, 25, 0)
    assert parse_place("60deg,25deg,0m", "--start", world, to_local) == (0, 0, 0)
    assert parse_place("61,25,0", "--start", world, to_local) == (61, 25, 0)  # 111 km beyond the map
    assert parse_place("60,25,0", "--start", world) == (60, 25, 0)  # a map without an anchor
    # Beyond the cells, the way to write degrees is shown.
    with pytest.raises(InputError, match=r"whole numbers are cells; degrees: 60deg,35deg,30m"):
        parse_place("60,35,30", "--start", world, to_local)


@pytest.mark.parametrize("text", ["1,2", "1,2,x", "1m,2,3", "1deg,2deg,3deg", "1.5c,2c,0c", "1e999,0.5,0", "", "1,,2", "1;2;3"])
def test_what_is_no_place(make_world: MakeWorld, text: str) -> None:
    with pytest.raises(InputError, match="--goal"):
        parse_place(text, "--goal", make_world((4, 4, 1)), lambda latitude_deg, longitude_deg: (0.0, 0.0))
