from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.evaluate import METRICS, evaluate_policies
from cellpilot.evaluate.evaluation import sampled_flights
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.instances import Instances, all_pairs, count_pairs, sample_pairs
from cellpilot.evaluate.summary import Summary, summarise
from cellpilot.policies import GreedyPolicy, OptimalPolicy, RandomPolicy
from cellpilot.policies.base import one_hot
from cellpilot.signal import Unknown
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
TASK = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-0.5, threshold_db=2.0, max_steps=20)


class TablePolicy:
    """Probabilities from a table `[n_cells, goals, actions]`."""

    name = "table"

    def __init__(self, probabilities: np.ndarray, deterministic: bool):
        self.probabilities, self.deterministic = probabilities.astype(np.float32), deterministic

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        return self.probabilities[:, goals]


def random_policy(world: World, seed: int, deterministic: bool) -> TablePolicy:
    """Shortest paths with random errors: some flights arrive, some loop, some hit the cap."""
    n, actions = world.grid.n_cells, world.airspace.n_actions
    rng = np.random.default_rng(seed)
    shortest = GreedyPolicy(world).action_probabilities(np.arange(n, dtype=np.int32))
    if deterministic:
        wrong = rng.random((n, n)) < 0.15
        return TablePolicy(np.where(wrong[..., None], one_hot(rng.integers(0, actions, (n, n)), actions), shortest), True)
    return TablePolicy(0.5 * shortest + 0.5 * rng.dirichlet(np.full(actions, 0.5), (n, n)), False)


def assert_same(found: Summary, expected: Summary, but: tuple[str, ...] = ()) -> None:
    for name in Summary.__dataclass_fields__.keys() - {"mobility"}:
        if name not in but:
            np.testing.assert_allclose(getattr(found, name), getattr(expected, name), rtol=1e-6, atol=1e-6, err_msg=name)


@settings(max_examples=12)
@given(st.integers(0, 2**31), st.sampled_from([(4, 3, 1), (2, 3, 2)]), st.sampled_from([0.0, 0.3]), st.sampled_from([0.0, 2.0]))
def test_exact_figures_of_a_deterministic_policy_against_plain_loops(
    random_world: MakeWorld, plain: Callable, seed: int, sides: tuple[int, int, int], share: float, noise: float
) -> None:
    world = random_world(seed, sides, share, noise, 1.0 if noise else 0.0)
    policy = random_policy(world, seed, deterministic=True)
    reference = plain(world)
    chance = world.signal.outage_probability(TASK.threshold_db)
    best = policy.probabilities.argmax(-1)
    flights, steps, low, total, reached = 0, 0, 0.0, 0.0, 0
    ratios, heights = [], np.zeros(sides[2])
    for part in reference.parts():
        for goal in part:
            distances = reference.distances(goal)
            for start in part - {goal}:
                here, flown, column = start, 0, reference.cell(goal)
                while here != goal and flown < TASK.max_steps:
                    here, stopped = reference.step(here, int(best[reference.cell(here), column]))
                    flown += 1
                    below = chance[reference.cell(here)]
                    low += below
                    total += -0.25 - 1.5 * below - 0.5 * stopped + 7.0 * (here == goal)
                    heights[here[2]] += 1
                flights, steps, reached = flights + 1, steps + flown, reached + (here == goal)
                ratios += [flown / distances[start]] if here == goal else []
    summary = exhaustive_summary(np.random.default_rng(0), world, TASK, policy)
    assert summary.n_flights == flights
    assert summary.n_steps == steps
    assert summary.low_steps == pytest.approx(low)
    assert summary.return_sum == pytest.approx(total)
    assert METRICS["reached_share"].compute(summary) == pytest.approx(reached / flights)
    assert METRICS["path_ratio_mean"].compute(summary) == pytest.approx(np.mean(ratios))
    assert METRICS["path_ratio_p90"].compute(summary) == pytest.approx(np.quantile(ratios, 0.9, method="inverted_cdf"))
    np.testing.assert_allclose(METRICS["altitude_share"].compute(summary), heights / steps)
    assert summary.sinr_histogram.sum() == pytest.approx(steps)
    assert summary.outages.sum() == flights


@settings(max_examples=10)
@given(st.integers(0, 2**31), st.sampled_from([(4, 3, 1), (2, 3, 2)]), st.sampled_from([0.0, 0.3]))
def test_the_recursion_of_a_one_hot_policy_is_its_flight(
    random_world: MakeWorld, seed: int, sides: tuple[int, int, int], share: float
) -> None:
    world = random_world(seed, sides, share, 1.5)
    flown = random_policy(world, seed, deterministic=True)
    recursed = TablePolicy(flown.probabilities, deterministic=False)
    found, expected = (exhaustive_summary(np.random.default_rng(0), world, TASK, p) for p in (recursed, flown))
    assert_same(found, expected)


@pytest.mark.parametrize(("sides", "share"), [((4, 3, 1), 0.0), ((4, 3, 1), 0.3), ((2, 3, 2), 0.2)])
def test_the_recursion_of_a_stochastic_policy_against_many_flights(
    random_world: MakeWorld, sides: tuple[int, int, int], share: float
) -> None:
    world = random_world(11, sides, share, 1.5, 1.0)
    policy = random_policy(world, 1, deterministic=False)
    exact = exhaustive_summary(np.random.default_rng(0), world, TASK, policy)
    starts, goals = all_pairs(world, world.airspace.free_cells)
    repeats = 60_000 // len(starts)
    instances = replace(
        sample_pairs(np.random.default_rng(0), world, 1), start=np.tile(starts, repeats), goal=np.tile(goals, repeats)
    )
    records, visits = sampled_flights(np.random.default_rng(1), world, TASK, policy, instances)
    drawn = summarise(records, visits, world, TASK, expected=False)
    n = drawn.n_flights
    assert exact.n_flights == len(starts)

    def within(found: float, expected: float, spread: float) -> None:
        assert abs(found - expected) < 5 * spread / np.sqrt(n)

    within(drawn.return_sum / n, exact.return_sum / exact.n_flights, records.drawn_return.std())
    within(drawn.n_steps / n, exact.n_steps / exact.n_flights, records.n_steps.std())
    within(drawn.low_steps / n, exact.low_steps / exact.n_flights, records.low_steps.std())
    within(drawn.arrivals.sum() / n, exact.arrivals.sum() / exact.n_flights, 0.5)
    by_steps = drawn.arrivals.sum(1) / n, exact.arrivals.sum(1) / exact.n_flights
    assert np.abs(by_steps[0] - by_steps[1]).max() < 5 * 0.5 / np.sqrt(n)
    np.testing.assert_allclose(drawn.steps_by_height / n, exact.steps_by_height / exact.n_flights, rtol=0.02)
    cumulative = [np.cumsum(s.sinr_histogram) / s.sinr_histogram.sum() for s in (drawn, exact)]
    assert np.abs(cumulative[0] - cumulative[1]).max() < 0.01
    in_expectation = summarise(records, visits, world, TASK, expected=True)
    within(in_expectation.return_sum / n, drawn.return_sum / n, records.drawn_return.std())


def test_the_random_walk_on_two_cells_by_hand(make_world: MakeWorld) -> None:
    """One action of four arrives: P(t) = (1/4)(3/4)^(t-1), up to a cap of 3 steps."""
    world = make_world((2, 1, 1), [10.0, -10.0])
    task = Task(max_steps=3)
    summary = exhaustive_summary(np.random.default_rng(0), world, task, RandomPolicy(world))
    assert summary.n_flights == 2
    np.testing.assert_allclose(summary.arrivals.sum(1) / 2, [0, 1 / 4, 3 / 16, 9 / 64])
    steps = 1 + 3 / 4 + 9 / 16
    assert summary.n_steps == pytest.approx(2 * steps)
    # towards the good cell every step that does not arrive measures low, towards the bad one the arrival does
    assert summary.low_steps == pytest.approx(steps * 3 / 4 + steps / 4)
    assert summary.return_sum == pytest.approx(2 * (10 * 37 / 64 - 0.1 * steps) - steps)


@pytest.mark.parametrize("deterministic", [True, False])
@pytest.mark.parametrize(("start", "goal"), [((0, 0, 0), None), (None, (3, 2, 0)), ((0, 0, 0), (3, 2, 0))])
def test_a_fixed_start_or_goal(
    random_world: MakeWorld,
    deterministic: bool,
    start: tuple[int, int, int] | None,
    goal: tuple[int, int, int] | None,
) -> None:
    world = random_world(2, (4, 3, 1), 0.0, 1.5)
    policy = random_policy(world, 2, deterministic)
    whole = [exhaustive_summary(np.random.default_rng(0), world, TASK, policy, s, g) for s, g in ((start, goal), (None, None))]
    n_pairs = {True: 11, False: 1}[start is None or goal is None]
    assert whole[0].n_flights == n_pairs
    assert count_pairs(world, start, goal) == (n_pairs, 0)
    singles = [
        exhaustive_summary(np.random.default_rng(0), world, TASK, policy, s, g)
        for s in ([start] if start else [tuple(p) for p in world.grid.position(np.arange(12)).tolist()])
        for g in ([goal] if goal else [tuple(p) for p in world.grid.position(np.arange(12)).tolist()])
        if s != g
    ]
    total = singles[0]
    for single in singles[1:]:
        total = total + single
    assert_same(whole[0], total, but=("outages",))


def test_goals_in_blocks_change_nothing(random_world: MakeWorld, monkeypatch: pytest.MonkeyPatch) -> None:
    from cellpilot.evaluate import exact

    world = random_world(6, (4, 3, 1), 0.2, 1.5)
    summaries = []
    for size in (1, 5, 100):
        monkeypatch.setattr(exact, "GOALS_AT_ONCE", size)
        summaries.append(
            [exhaustive_summary(np.random.default_rng(0), world, TASK, random_policy(world, 1, d)) for d in (True, False)]
        )
    for one, two in (summaries[:2], summaries[1:]):
        assert_same(one[0], two[0], but=("outages",))
        assert_same(one[1], two[1], but=("outages",))


def test_pairs_cut_apart_are_counted(make_world: MakeWorld) -> None:
    """Parts of 4 and 2 cells: 4 x 3 + 2 x 1 pairs can be flown, 2 x 4 x 2 cannot; a lonely cell does not count."""
    blocked = [(2, 0, 0), (2, 1, 0), (3, 1, 0), (5, 0, 0), (4, 1, 0), (5, 1, 0), (6, 1, 0)]
    world = make_world((7, 2, 1), blocked=blocked)
    assert count_pairs(world) == (14, 16)
    assert count_pairs(world, start=(0, 0, 0)) == (3, 2)
    result = evaluate_policies(world, Task(), [GreedyPolicy(world), OptimalPolicy(world, Task())], seed=0, n_sampled=500)
    assert (result.n_pairs, result.unreachable_pairs) == (14, 16)
    assert all(row["reached_share"] == 1.0 for row in result.policies.values())
    instances = sample_pairs(np.random.default_rng(0), world, 500)
    assert instances.unreachable_pairs == 16
    assert (world.airspace.part[instances.start] == world.airspace.part[instances.goal]).all()
    assert (instances.start != instances.goal).all()


def test_every_policy_flies_the_same_instances(random_world: MakeWorld) -> None:
    world = random_world(8, (5, 5, 1), 0.2, 2.0)
    task = Task(max_steps=100)
    policies = [GreedyPolicy(world), replace(GreedyPolicy(world), name="again"), OptimalPolicy(world, task), RandomPolicy(world)]
    result = evaluate_policies(world, task, policies, seed=5, n_sampled=300)
    shortest = result.flights["greedy"].shortest_steps
    for records in result.flights.values():
        np.testing.assert_array_equal(records.shortest_steps, shortest)
    for name in ("drawn_return", "n_steps", "low_steps", "longest_outage_steps"):  # same noise as well
        np.testing.assert_array_equal(getattr(result.flights["again"], name), getattr(result.flights["greedy"], name))
    assert result.sampled["again"] == result.sampled["greedy"]
    np.testing.assert_array_equal(result.flights["greedy"].n_steps, shortest)
    instances = sample_pairs(np.random.default_rng([5, 0]), world, 300)
    np.testing.assert_array_equal(world.airspace.shortest_steps(instances.goal)[instances.start, np.arange(300)], shortest)

    again, other = (evaluate_policies(world, task, policies[:1], seed=seed, n_sampled=300) for seed in (5, 6))
    assert again.sampled["greedy"]["return_mean"] == result.sampled["greedy"]["return_mean"]
    assert (other.flights["greedy"].shortest_steps != shortest).any()


def test_sampled_figures_lie_around_the_exact_ones(random_world: MakeWorld) -> None:
    """Three intervals of three policies: at 4.5 standard errors none may miss."""
    world = random_world(9, (5, 5, 1), 0.0, 2.0)
    task = Task(max_steps=60)
    policies = [GreedyPolicy(world), OptimalPolicy(world, task), RandomPolicy(world)]
    result = evaluate_policies(world, task, policies, seed=1, n_sampled=4_000)
    assert result.exhaustive
    for name, exact in result.policies.items():
        sampled = result.sampled[name]
        for metric, interval in (
            ("return_mean", "return_ci95"),
            ("low_sinr_share", "low_sinr_ci95"),
            ("reached_share", "reached_ci95"),
            ("path_ratio_mean", "path_ratio_mean_ci95"),
        ):
            low, high = sampled[interval]
            assert low <= sampled[metric] <= high
            assert abs(exact[metric] - sampled[metric]) <= 4.5 / 1.96 * (high - low) / 2 + 1e-9
            assert exact[interval] is None
    assert result.sampled["random"]["return_ci95"][1] - result.sampled["random"]["return_ci95"][0] > 0


def test_too_many_pairs_are_sampled(random_world: MakeWorld) -> None:
    world = random_world(9, (4, 4, 1))
    shares: list[float] = []
    result = evaluate_policies(
        world,
        Task(),
        [GreedyPolicy(world), RandomPolicy(world)],
        seed=1,
        n_sampled=50,
        max_exhaustive_pairs=240,
        progress=shares.append,
    )
    assert not result.exhaustive
    assert result.policies == result.sampled
    assert result.policies["greedy"]["return_ci95"] is not None
    assert shares[-1] == 1.0
    assert shares == sorted(shares)
    assert evaluate_policies(world, Task(), [GreedyPolicy(world)], seed=1, n_sampled=50, max_exhaustive_pairs=241).exhaustive


def test_score_and_regret(random_world: MakeWorld) -> None:
    world = random_world(10, (5, 5, 1))
    task = Task(max_steps=100)
    table = evaluate_policies(
        world, task, [GreedyPolicy(world), OptimalPolicy(world, task), RandomPolicy(world)], seed=1, n_sampled=50
    ).policies
    best, base = table["optimal"]["return_mean"], table["greedy"]["return_mean"]
    assert best > base
    assert (table["optimal"]["score"], table["greedy"]["score"]) == (1.0, 0.0)
    assert table["optimal"]["regret_mean"] == 0.0
    assert table["greedy"]["regret_mean"] == pytest.approx(best - base)
    assert table["random"]["score"] == pytest.approx((table["random"]["return_mean"] - base) / (best - base))
    assert table["random"]["score"] < 0  # not clipped


def test_no_score_where_there_is_nothing_to_gain_or_to_compare(make_world: MakeWorld) -> None:
    world = make_world((4, 4, 1))
    task = Task()
    flat = evaluate_policies(
        world, task, [GreedyPolicy(world), OptimalPolicy(world, task), RandomPolicy(world)], seed=1, n_sampled=20
    )
    assert {row["score"] for row in flat.policies.values()} == {None}
    assert flat.policies["random"]["regret_mean"] > 0
    alone = evaluate_policies(world, task, [GreedyPolicy(world)], seed=1, n_sampled=20)
    assert alone.policies["greedy"]["score"] is None
    assert alone.policies["greedy"]["regret_mean"] is None


def test_an_uncertain_map_is_drawn_once_per_flight(make_world: MakeWorld) -> None:
    """Waiting in one cell at the threshold: every step of a flight is low or none is."""
    world = make_world((2, 1, 1), 3.0, sinr_std_db=2.0)
    task = Task(max_steps=5)
    stay = TablePolicy(np.broadcast_to([1.0, 0, 0, 0], (2, 2, 4)), True)
    instances = sample_pairs(np.random.default_rng(0), world, 400)
    records, _ = sampled_flights(np.random.default_rng(1), world, task, stay, instances)
    assert set(records.low_steps.tolist()) == {0, 5}
    assert abs((records.low_steps == 5).mean() - 0.5) < 5 * 0.5 / 20
    np.testing.assert_array_equal(records.longest_outage_steps, records.low_steps)
    np.testing.assert_allclose(records.expected_low_steps, 2.5)

    noisy = replace(world, signal=replace(world.signal, unknown=None, noise_std_db=2.0))
    records, _ = sampled_flights(np.random.default_rng(1), noisy, task, stay, instances)
    assert set(records.low_steps.tolist()) == {0, 1, 2, 3, 4, 5}
    assert (records.longest_outage_steps <= records.low_steps).all()
    assert (records.longest_outage_steps < records.low_steps).any()


def test_an_error_common_to_all_cells_widens_what_flights_over_drawn_worlds_meet(make_world: MakeWorld) -> None:
    """Along a row at the threshold: as many low steps on average, in longer outages, and with a wider interval of the mean."""
    world = make_world((12, 1, 1), 3.0, sinr_std_db=2.0)
    grid, std_db = world.grid, world.signal.std_db
    common = replace(world, signal=replace(world.signal, unknown=Unknown.of(grid, std_db, 0.0, 1.8)))
    instances = Instances(np.zeros(800, np.int32), np.full(800, 11, np.int32), 0)
    draw = lambda of, seed: sampled_flights(np.random.default_rng(seed), of, Task(max_steps=20), GreedyPolicy(of), instances)[0]
    (alone, shared), again = (draw(of, 1) for of in (world, common)), draw(common, 1)
    np.testing.assert_array_equal(shared.low_steps, again.low_steps)
    assert (shared.low_steps != draw(common, 2).low_steps).any()
    assert shared.low_steps.mean() == pytest.approx(alone.low_steps.mean(), abs=0.6)
    assert shared.low_steps.std() > 2 * alone.low_steps.std()
    assert shared.drawn_return.std() > 2 * alone.drawn_return.std()
    assert shared.longest_outage_steps.mean() > alone.longest_outage_steps.mean() + 1


def test_the_share_below_counts_cells_entered_and_failures_too(make_world: MakeWorld) -> None:
    """A corridor with low cells at 0 and 2: eastwards from 0 the start does not count."""
    world = make_world((4, 1, 1), [-5.0, 9.0, -5.0, 9.0])
    task = Task(max_steps=10)
    greedy = exhaustive_summary(np.random.default_rng(0), world, task, GreedyPolicy(world), (0, 0, 0), (3, 0, 0))
    assert (greedy.n_steps, greedy.low_steps) == (3, 1)
    waiting = TablePolicy(np.broadcast_to([1.0, 0, 0, 0], (4, 4, 4)), True)
    failed = exhaustive_summary(np.random.default_rng(0), world, task, waiting, (0, 0, 0), (3, 0, 0))
    assert (failed.n_steps, failed.low_steps) == (10, 10)
    assert failed.return_sum == pytest.approx(-11.0)
    both = greedy + failed
    assert METRICS["low_sinr_share"].compute(both) == pytest.approx(11 / 13)
    assert METRICS["reached_share"].compute(both) == 0.5
    assert METRICS["path_ratio_p50"].compute(both) == 1.0
    assert METRICS["path_ratio_p90_failures_infinite"].compute(both) == np.inf
    assert METRICS["path_ratio_p90"].compute(failed) is None
    assert METRICS["path_ratio_mean"].compute(failed) is None


def test_on_a_large_map_sampled_flights_lead_to_few_goals_and_say_how_far_they_are(
    random_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    from cellpilot.evaluate import evaluation, exact

    world, task = random_world(0, (30, 20, 1)), Task(max_steps=500)
    assert evaluation.most_goals(world) is None
    monkeypatch.setattr(evaluation, "LARGE_CELLS", 500)
    monkeypatch.setattr(evaluation, "GOALS_TIMES_CELLS", 12 * 600)
    monkeypatch.setattr(exact, "MOST_PAIRS", 5 * 600)
    instances = sample_pairs(np.random.default_rng([3, 0]), world, 400, n_goals=evaluation.most_goals(world))
    assert 6 <= np.unique(instances.goal).size <= 12
    assert np.unique(instances.start).size > 150
    shares: list[float] = []
    sampling = {"seed": 3, "n_sampled": 400, "max_exhaustive_pairs": 10}
    found = evaluate_policies(world, task, [GreedyPolicy(world), OptimalPolicy(world, task)], **sampling, progress=shares.append)
    assert not found.exhaustive
    assert len(shares) >= 6
    assert shares == sorted(shares)
    assert shares[-1] == 1.0
    assert found.policies["optimal"]["return_mean"] > found.policies["greedy"]["return_mean"]
    # Small tables at a time change no number.
    monkeypatch.setattr(exact, "MOST_PAIRS", 10**9)
    again = evaluate_policies(world, task, [GreedyPolicy(world)], **sampling)
    assert again.sampled["greedy"]["return_mean"] == found.sampled["greedy"]["return_mean"]
