from collections.abc import Callable
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.airspace import STOPPED
from cellpilot.errors import InputError
from cellpilot.evaluate import evaluate_policies
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.policies import GreedyPolicy, OptimalPolicy, RandomPolicy
from cellpilot.policies.base import greedy_actions, one_hot
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]


def plain_reward(world: World, task: Task, there: int, stopped: bool, goal: int) -> float:
    """Equation 4.4 in words: every step, a low measurement, a blocked move, the goal."""
    low = float(world.signal.outage_probability(task.threshold_db)[there])
    return task.rho_step + task.rho_sinr * low + task.rho_blocked * stopped + task.rho_goal * (there == goal)


def plain_values(
    world: World, reference: object, task: Task, goal: int, gamma: float, sweeps: int
) -> dict[tuple[int, int], float]:
    """Value iteration over dictionaries."""
    positions = reference.positions
    free = [p for p in positions if p not in reference.blocked]
    steps = {
        (reference.cell(p), a): (reference.cell(reference.step(p, a)[0]), reference.step(p, a)[1])
        for p in free
        for a in range(len(reference.moves))
    }
    reward = {key: plain_reward(world, task, there, stopped, goal) for key, (there, stopped) in steps.items()}
    value = {reference.cell(p): -1e6 for p in free}
    q: dict[tuple[int, int], float] = {}
    for _ in range(sweeps):
        q = {key: reward[key] + (0.0 if there == goal else gamma * value[there]) for key, (there, _) in steps.items()}
        value = {cell: max(q[cell, a] for a in range(len(reference.moves))) for cell in value}
    return q


@pytest.mark.parametrize("sides", [(3, 3, 1), (2, 2, 2)])
@pytest.mark.parametrize("gamma", [0.995, 1.0])
@pytest.mark.parametrize("seed", [0, 1])
def test_values_against_plain_value_iteration(
    random_world: MakeWorld, plain: Callable, seed: int, sides: tuple[int, int, int], gamma: float
) -> None:
    world = random_world(seed, sides, 0.2, noise_std_db=2.0, sinr_std_db=1.0)
    task = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-0.5, threshold_db=2.0)
    reference = plain(world)
    goals = world.airspace.free_cells
    values = optimal_values(world, task, goals, gamma)
    assert values.shape == (world.grid.n_cells, len(goals), world.airspace.n_actions)
    for column, goal in enumerate(goals):
        q = plain_values(world, reference, task, int(goal), gamma, 80)
        for (cell, action), value in q.items():
            if world.airspace.part[cell] == world.airspace.part[goal] and cell != goal:
                assert values[cell, column, action] == pytest.approx(value, abs=1e-6)


@pytest.mark.parametrize("gamma", [0.995, 1.0])
def test_values_against_every_path(random_world: MakeWorld, plain: Callable, gamma: float) -> None:
    """The best of all flights of up to eight moves over 3 x 3 cells, enumerated."""
    world = random_world(7, (3, 3, 1))
    task = Task(rho_sinr=-0.4)
    reference = plain(world)
    goal = 8
    best: dict[int, float] = {}

    def search(start: int, position: tuple[int, int, int], seen: frozenset, total: float, weight: float) -> None:
        for action in range(4):
            there, stopped = reference.step(position, action)
            if there in seen:
                continue
            cell = reference.cell(there)
            value = total + weight * plain_reward(world, task, cell, stopped, goal)
            if cell == goal:
                best[start] = max(best.get(start, -np.inf), value)
            else:
                search(start, there, seen | {there}, value, weight * gamma)

    for start in range(8):
        search(start, reference.positions[start], frozenset([reference.positions[start]]), 0.0, 1.0)
    values = optimal_values(world, task, np.array([goal]), gamma)[:, 0].max(-1)
    np.testing.assert_allclose(values[:8], [best[s] for s in range(8)], atol=1e-9)


def test_ties_go_to_the_lowest_action(make_world: MakeWorld) -> None:
    """With nothing to avoid, north-east is reached by north first, south-west by south first."""
    world = make_world((4, 4, 1))
    actions = OptimalPolicy(world, Task()).actions(world.airspace.free_cells)
    for start, goal in product(range(16), repeat=2):
        (x, y, _), (gx, gy, _) = world.grid.position(start), world.grid.position(goal)
        if (x, y) != (gx, gy):
            expected = 0 if gy > y else 1 if gy < y else 2 if gx > x else 3
            assert actions[start, goal] == expected


def test_the_order_of_goals_and_repeated_questions_change_nothing(random_world: MakeWorld) -> None:
    world = random_world(3, (4, 3, 1), 0.2)
    goals = world.airspace.free_cells
    policy = OptimalPolicy(world, Task())
    some = policy.action_probabilities(goals[[3, 0]])
    every = policy.action_probabilities(goals)
    np.testing.assert_array_equal(some, every[:, [3, 0]])
    np.testing.assert_array_equal(OptimalPolicy(world, Task()).action_probabilities(goals), every)
    np.testing.assert_array_equal(policy.action_probabilities(goals[[1, 1]]), every[:, [1, 1]])


def test_more_goals_than_one_block(random_world: MakeWorld) -> None:
    world = random_world(4, (10, 8, 1))  # 80 goals
    goals = world.airspace.free_cells
    values = optimal_values(world, Task(), goals)
    for goal in (0, 63, 64, 79):
        np.testing.assert_allclose(values[:, goal], optimal_values(world, Task(), goals[[goal]])[:, 0], atol=1e-8)


class TablePolicy:
    """Any deterministic policy."""

    name, deterministic = "table", True

    def __init__(self, actions: np.ndarray, n_actions: int):
        self.actions, self.n_actions = actions, n_actions

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        return one_hot(self.actions[:, goals].astype(np.int8), self.n_actions)


@settings(max_examples=15)
@given(st.integers(0, 2**31), st.sampled_from([(4, 3, 1), (2, 2, 3)]), st.sampled_from([0.0, 0.25]), st.sampled_from([0.0, 2.0]))
def test_nobody_beats_the_optimum(
    random_world: MakeWorld, seed: int, sides: tuple[int, int, int], share: float, noise: float
) -> None:
    """Every flight ends within the cap here, so the undiscounted optimum is the best that exhaustive figures can show."""
    world = random_world(seed, sides, share, noise)
    task = Task(max_steps=200, rho_blocked=-0.2)
    mean = lambda policy: (lambda s: s.return_sum / s.n_flights)(
        exhaustive_summary(np.random.default_rng(0), world, task, policy)
    )
    best = mean(OptimalPolicy.undiscounted(world, task))
    n = world.grid.n_cells
    rng = np.random.default_rng(seed)
    greedy = GreedyPolicy(world).action_probabilities(np.arange(n, dtype=np.int32)).argmax(-1)
    noisy = np.where(rng.random((n, n)) < 0.1, rng.integers(0, world.airspace.n_actions, (n, n)), greedy)
    others = [OptimalPolicy(world, task), GreedyPolicy(world), RandomPolicy(world), TablePolicy(noisy, world.airspace.n_actions)]
    for other in others:
        assert mean(other) <= best + 1e-7


def test_the_discounted_optimum_can_return_less_than_the_undiscounted_one(make_world: MakeWorld) -> None:
    """A detour of 2 more steps (-0.2) around one low cell (-1 at 0.25 of the measurements) pays only undiscounted."""
    sinr = np.full(9, 50.0)
    sinr[1] = 3.0 + 2.0 * 0.6745  # low with chance 0.25
    world = make_world((3, 3, 1), sinr, noise_std_db=2.0)
    task = Task()
    goal = np.array([2])
    assert OptimalPolicy(world, task).actions(goal)[0, 0] == 2
    assert OptimalPolicy.undiscounted(world, task).actions(goal)[0, 0] == 0
    table = evaluate_policies(
        world, task, [OptimalPolicy(world, task), OptimalPolicy.undiscounted(world, task)], seed=0, n_sampled=10
    )
    assert table.policies["optimal"]["return_mean"] < table.policies["optimal-undiscounted"]["return_mean"]


@pytest.mark.parametrize("task", [Task(rho_step=0.1), Task(rho_step=-0.1, rho_sinr=0.5), Task(rho_blocked=1.0)])
def test_no_undiscounted_optimum_where_circling_earns(random_world: MakeWorld, task: Task) -> None:
    world = random_world(1, (4, 3, 1), 0.2, noise_std_db=3.0)
    assert (world.airspace.event[~world.airspace.blocked] == STOPPED).any()
    with pytest.raises(InputError, match="circling earns"):
        OptimalPolicy.undiscounted(world, task).actions(world.airspace.free_cells[:2])


def test_with_discount_circling_may_earn(make_world: MakeWorld) -> None:
    """A reward per step worth more than the goal: waiting for ever is the optimum, 1 / (1 - 0.9)."""
    world = make_world((3, 1, 1))
    values = optimal_values(world, Task(rho_goal=1.0, rho_step=1.0, discount=0.9), np.array([2]))
    assert values[0, 0].max() == pytest.approx(10.0, abs=1e-6)
    assert values[1, 0].tolist() == pytest.approx([10.0, 10.0, 2.0, 10.0], abs=1e-6)


def test_costless_steps_without_discount_still_reach_the_goal(make_world: MakeWorld) -> None:
    """All actions have the same value where steps cost nothing; a policy that takes the first of them never arrives."""
    world = make_world((3, 3, 1))
    task = Task(rho_step=0.0, max_steps=50)
    try:
        policy = OptimalPolicy.undiscounted(world, task)
        summary = exhaustive_summary(np.random.default_rng(0), world, task, policy)
    except InputError:
        return  # naming the problem is as good
    assert summary.return_sum / summary.n_flights == pytest.approx(10.0)


@pytest.mark.parametrize("discount", [0.995, 0.9999])
def test_worlds_in_two_parts_are_solved_with_any_discount(make_world: MakeWorld, discount: float) -> None:
    """Cells that cannot reach the goal fly for ever; their values must neither fail nor hold up the others."""
    world = make_world((5, 1, 1), blocked=[(2, 0, 0)])
    task = Task(discount=discount)
    values = optimal_values(world, task, np.array([0]))
    assert values[1, 0].max() == pytest.approx(9.9)
    assert OptimalPolicy(world, task).actions(np.array([0]))[1, 0] == 3
    assert OptimalPolicy.undiscounted(world, task).actions(np.array([0]))[1, 0] == 3


def test_the_task_sets_the_discount(make_world: MakeWorld) -> None:
    world = make_world((4, 1, 1))
    task = Task(discount=0.5)
    expected = -0.1 + 0.5 * (-0.1 + 0.5 * 9.9)
    assert optimal_values(world, task, np.array([3]))[0, 0].max() == pytest.approx(expected)
    assert optimal_values(world, replace(task, discount=0.9), np.array([3]), 0.5)[0, 0].max() == pytest.approx(expected)


@settings(max_examples=25)
@given(
    st.integers(0, 2**31),
    st.tuples(*[st.sampled_from([-3.0, -0.5, 0.0, 0.25, 4.0])] * 4),
    st.sampled_from([0.5, 0.9, 0.99]),
)
def test_value_bounds_hold_for_every_flight(
    random_world: MakeWorld, seed: int, rewards: tuple[float, float, float, float], discount: float
) -> None:
    """No value of the best policy, nor of the worst, leaves the bounds of the task."""
    world = random_world(seed, (3, 3, 1), 0.25)
    task = Task(*rewards, discount=discount)
    low, high = task.value_bounds()
    goals = world.airspace.free_cells
    flying = (np.arange(world.grid.n_cells)[:, None] != goals) & ~world.airspace.blocked[:, None]
    best = optimal_values(world, task, goals)[flying]
    worst = -optimal_values(world, Task(*(-rho for rho in rewards), discount=discount), goals)[flying]
    assert worst.min() >= low - 1e-5
    assert best.max() <= high + 1e-5


def test_value_bounds_by_hand() -> None:
    low, high = Task(discount=0.9).value_bounds()
    assert (low, high) == pytest.approx((-11.0, 10.0))  # 1.1 for ever, or the goal at once
    assert Task(discount=1.0).value_bounds() == (-np.inf, 10.0)
    assert Task(rho_blocked=-0.9, discount=0.5).value_bounds() == pytest.approx((-4.0, 10.0))


@given(st.integers(0, 2**31), st.sampled_from([(5, 4, 1), (3, 3, 2)]), st.sampled_from([0.0, 0.4]), st.sampled_from([0.0, 2.0]))
def test_undiscounted_values_are_those_of_repeated_backing_up(
    random_world: Callable[..., World], seed: int, sides: tuple[int, int, int], share: float, noise: float
) -> None:
    """The same from sweeps by hand: as many as there are cells, from nothing known."""
    world = random_world(seed, sides, share, noise)
    task = Task(rho_goal=4.0, rho_sinr=-0.7, rho_step=-0.2, rho_blocked=-0.1)
    low = np.nan_to_num(world.signal.outage_probability(task.threshold_db))
    for goal in world.airspace.free_cells[::3]:
        value = np.full(world.grid.n_cells, -np.inf)
        for _ in range(world.grid.n_cells):
            reward = (
                task.rho_step
                + task.rho_sinr * low[world.airspace.next_cell]
                + task.rho_blocked * (world.airspace.event == STOPPED)
            )
            arrives = world.airspace.next_cell == goal
            q = reward + np.where(arrives, task.rho_goal, value[world.airspace.next_cell])
            value = q.max(-1)
            value[goal] = -np.inf
        found = optimal_values(world, task, np.array([goal]), 1.0)[:, 0]
        here = (world.airspace.part == world.airspace.part[goal]) & (np.arange(world.grid.n_cells) != goal)
        np.testing.assert_allclose(found[here], q[here], atol=1e-9)
        assert np.isneginf(found[(world.airspace.part >= 0) & (world.airspace.part != world.airspace.part[goal])]).all()


@pytest.mark.parametrize("discount", [0.5, 0.95, 0.995])
@pytest.mark.parametrize(("sides", "blocked_share"), [((12, 9, 1), 0.0), ((12, 9, 1), 0.2), ((6, 5, 3), 0.15)])
def test_policy_iteration_finds_the_values_of_value_iteration(
    random_world: Callable[..., World],
    monkeypatch: pytest.MonkeyPatch,
    sides: tuple[int, int, int],
    blocked_share: float,
    discount: float,
) -> None:
    from cellpilot.solve import values as solve_values

    world, task = random_world(3, sides, blocked_share), Task(discount=discount, rho_blocked=-0.2, max_steps=500)
    goals = world.airspace.free_cells[:: len(world.airspace.free_cells) // 7]
    swept = solve_values.optimal_values(world, task, goals)
    monkeypatch.setattr(solve_values, "LARGE_CELLS", 10)
    improved = solve_values.optimal_values(world, task, goals)
    alive = np.ones(swept.shape[:2], bool)
    alive[goals, np.arange(len(goals))] = False
    alive &= ~world.airspace.blocked[:, None] & (world.airspace.part[:, None] == world.airspace.part[goals][None, :])
    np.testing.assert_allclose(improved[alive], swept[alive], atol=1e-6)
    np.testing.assert_array_equal(greedy_actions(improved)[alive], greedy_actions(swept)[alive])
