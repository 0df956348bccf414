"""FQI-HER: its parts against plain arithmetic, and small tasks with known values."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.special import ndtr

from cellpilot.airspace import Airspace
from cellpilot.envs.arena import make_arena
from cellpilot.errors import InputError
from cellpilot.evaluate import evaluate_policies
from cellpilot.grid import Grid
from cellpilot.learn.algorithms import fqi_her, fqi_her_targets
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.learner import Place
from cellpilot.learn.losses import huber
from cellpilot.learn.pair_network import sum_of_rows
from cellpilot.learn.penalty import measure, no_measurements, penalty_model, replayed_penalty
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.policies.pair_value import distance, n_rows, pair_rows, upper_bound
from cellpilot.signal import Signal, Unknown
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

SMALL = FQIHER(
    rounds=60, flights=16, steps_per_round=12, updates_per_round=15, batch_size=256, goals_per_round=25, hidden_units=32
)


def make_world(seed: int = 0, sides: tuple[int, int, int] = (5, 5, 1), noise_std_db: float = 0.0, blocked: int = 0) -> World:
    """A random world, some cells of it blocked, 40 % of the rest below 3 dB."""
    rng = np.random.default_rng(seed)
    grid = Grid(*(tuple(20.0 * i for i in range(side)) for side in sides))
    sinr_db = np.where(rng.random(grid.n_cells) < 0.4, -2.0, 8.0) + rng.uniform(-0.5, 0.5, grid.n_cells)
    stones = np.zeros(grid.n_cells, bool)
    stones[rng.choice(grid.n_cells, blocked, replace=False)] = True
    return World(Airspace.of_blocked(grid, stones), Signal(sinr_db.astype(np.float32), noise_std_db))


collect = jax.jit(fqi_her.collect, static_argnums=(1, 3))


def learn(world: World, task: Task, settings: FQIHER, seed: int = 0) -> LearnedPolicy:
    """Train and take the policy out."""
    result = train_one(settings, Place(world, task), seed)
    return LearnedPolicy(result.policy_parameters({"task": task.as_dict()}), world.grid)


@pytest.mark.parametrize(("sides", "expected"), [((20, 20, 1), 3921), ((20, 20, 5), 19714)])
def test_every_pair_has_its_rows_inside_the_table(sides: tuple[int, int, int], expected: int) -> None:
    assert n_rows(sides) == expected
    cells = np.arange(int(np.prod(sides)))
    rows = pair_rows(sides, cells[:, None], cells[None, ::7])
    for one, following in zip(rows, [*rows[1:], None], strict=True):
        assert one.shape == (cells.size, cells[::7].size)
        end = expected if following is None else following.min()
        assert one.max() < end  # the parts of the table do not overlap


@pytest.mark.parametrize("blocked", [0, 5])
def test_the_bound_is_never_below_the_optimum(blocked: int) -> None:
    world, task = make_world(3, (6, 4, 2), 2.0, blocked), Task(max_steps=80)
    goals = world.airspace.free_cells
    low = np.nan_to_num(world.signal.outage_probability(task.threshold_db))
    values = optimal_values(world, task, goals).max(-1)
    cell = np.arange(world.grid.n_cells)[:, None]
    bound = upper_bound(task, distance(world.grid.sides, cell, goals[None]), low[goals][None])
    inside = (cell != goals[None]) & ~world.airspace.blocked[:, None]
    assert (bound >= values - 1e-9)[inside].all()
    assert np.isclose(bound, values)[inside].any()  # and it is reached by a good flight, so it is not idle


def test_the_learned_penalty_is_the_normal_chance_of_what_was_measured() -> None:
    rng = np.random.default_rng(0)
    memory = no_measurements(3, 4)
    drawn = rng.normal([5.0, 1.0], 2.0, (400, 2)).astype(np.float32)
    for row in drawn:
        memory = measure(memory, jnp.array([0, 1]), jnp.asarray(row))
    chance = np.asarray(penalty_model(memory, 3.0))
    expected = ndtr((3.0 - drawn.mean(0)) / drawn.std(0))
    assert np.abs(chance[:2] - expected).max() < 0.01
    assert chance[2] == pytest.approx(chance[:2].mean(), abs=1e-6)  # never measured: the mean chance
    share = np.mean([np.asarray(replayed_penalty(jax.random.key(i), memory, 3.0)) for i in range(300)], axis=0)
    assert np.abs(share[:2] - (drawn[-4:] < 3.0).mean(0)).max() < 0.1  # the last four are stored
    assert share[2] == 0


def test_without_noise_the_penalty_is_certain_at_the_threshold_itself() -> None:
    memory = no_measurements(2, 4)
    for _ in range(50):
        memory = measure(memory, jnp.array([0, 1, 1]), jnp.array([3.0, 2.9999, 2.9999], jnp.float32))
    assert np.asarray(penalty_model(memory, 3.0)).tolist() == [0.0, 1.0]
    assert np.asarray(memory.count).tolist() == [50, 100]


def test_flights_that_enter_a_cell_together_leave_no_measurement_that_was_never_made() -> None:
    memory = measure(no_measurements(2, 8), jnp.array([0, 0, 0]), jnp.array([20.0, 21.0, 22.0]))
    memory = measure(memory, jnp.array([0, 0, 1]), jnp.array([23.0, 24.0, -5.0]))
    low = np.array([np.asarray(replayed_penalty(jax.random.key(i), memory, 3.0)) for i in range(200)])
    assert low.mean(0).tolist() == [0.0, 1.0]


def test_huber_by_hand() -> None:
    assert np.asarray(huber(jnp.array([0.2, -0.5, 2.0]))).tolist() == pytest.approx([0.02, 0.125, 0.875])


@pytest.mark.parametrize("model", [True, False])
def test_the_policy_flies_on_numpy_as_it_was_trained(model: bool, tmp_path) -> None:  # type: ignore[no-untyped-def]
    world, task = make_world(1, (4, 3, 2), 1.0, 3), Task(max_steps=60, rho_blocked=-0.3)
    settings = SMALL.changed(rounds=5, penalty_model=model, networks=2, look_ahead=1)
    place = Place(world, task)
    result = train_one(settings, place, 0)
    save_parameters(result.policy_parameters({"task": task.as_dict()}), tmp_path / "p.safetensors")
    goals = world.airspace.free_cells
    found = load_parameters(tmp_path / "p.safetensors").values(world.grid, goals)
    penalty = penalty_model(result.state.memory, task.threshold_db) if model else None
    arena, cells = make_arena(world), jnp.arange(world.grid.n_cells)
    values = jax.jit(lambda goal: fqi_her.flying_values(result.state.average, arena, task, penalty, cells, goal))
    for column, goal in enumerate(goals):
        expected = values(jnp.full_like(cells, goal))
        assert np.abs(found[:, column] - np.asarray(expected)).max() < 1e-4


@pytest.mark.parametrize(("model", "noise_std_db", "networks"), [(True, 0.0, 1), (True, 2.0, 2), (False, 0.0, 1)])
def test_a_small_world_is_learned(model: bool, noise_std_db: float, networks: int) -> None:
    world, task = make_world(2, noise_std_db=noise_std_db, blocked=2), Task(max_steps=100)
    policy = learn(
        world,
        task,
        SMALL.changed(
            rounds=60 if model else 200, penalty_model=model, networks=networks, look_ahead=SMALL.look_ahead if model else 1
        ),
    )
    result = evaluate_policies(world, task, [GreedyPolicy(world), OptimalPolicy(world, task), policy], seed=0, n_sampled=10)
    row = result.policies["learned/argmax"]
    assert row["reached_share"] == 1
    assert row["score"] > 0.97


def test_an_error_counts_what_waiting_costs() -> None:
    task = Task(discount=0.9, rho_step=-0.1)  # waiting for ever is worth -1, so a step of waiting at -0.5 costs half
    found = np.asarray(fqi_her_targets.importance(task, jnp.array([0.0, -0.5, 1.0, -0.99])))
    assert found.tolist() == pytest.approx([1.0, 2.0, 0.5, fqi_her_targets.MOST_IMPORTANT], rel=1e-5)
    assert np.asarray(fqi_her_targets.importance(Task(discount=1.0), jnp.array([-7.0, 7.0]))).tolist() == [1.0, 1.0]


def test_a_bonus_leads_to_cells_that_were_rarely_measured() -> None:
    world, task = make_world(6, (8, 8, 1), 1.0), Task(max_steps=100)
    settings = SMALL.changed(rounds=40, updates_per_round=1)
    counts = [
        np.asarray(train_one(settings.changed(count_bonus=bonus), Place(world, task), 0).state.memory.count)
        for bonus in (0.0, 100.0)
    ]
    assert counts[0].sum() == counts[1].sum()
    assert counts[1].min() > 1.5 * counts[0].min()


def test_pairs_are_drawn_in_proportion_to_their_error() -> None:
    error = np.random.default_rng(0).random((6, 25)) * (np.arange(25) % 3 > 0)
    arena, zero = make_arena(make_world(7)), jnp.zeros((6, 25))
    cache = fqi_her_targets.TargetCache(jnp.arange(6), zero, jnp.asarray(error, jnp.float32), zero > -1, jnp.zeros(25, jnp.int32))
    settings = SMALL.changed(prioritised=1.0, near=0.0, updates_per_round=100, batch_size=1000)
    column, cell = (
        np.asarray(x).ravel() for x in fqi_her_targets.draw_pairs(jax.random.key(0), settings, arena, cache, jnp.int32(6))
    )
    found = np.bincount(column * 25 + cell, minlength=150).reshape(6, 25) / column.size
    assert np.abs(found - error / error.sum()).max() < 0.002
    assert (found[error == 0] == 0).all()


def test_the_gradient_of_a_sum_of_rows_is_that_of_the_plain_sum() -> None:
    table = jax.random.normal(jax.random.key(0), (9, 4))
    rows = (jnp.array([0, 3, 3, 8]), jnp.array([3, 3, 1, 0]))
    plain = lambda table: jnp.square(table[rows[0]] + table[rows[1]]).sum()
    ours = lambda table: jnp.square(sum_of_rows(table, rows)).sum()
    assert np.allclose(jax.grad(ours)(table), jax.grad(plain)(table), rtol=1e-6)


def test_seeds_differ_and_equal_seeds_are_equal_however_training_is_cut() -> None:
    world, task = make_world(4, noise_std_db=1.0), Task(max_steps=50)
    place, settings = Place(world, task), SMALL.changed(rounds=7)
    whole = train_one(settings, place, 5, chunk_rounds=7)
    cut = train_one(settings, place, 5, chunk_rounds=2)
    other = train_one(settings, place, 6, chunk_rounds=7)
    tables = [np.asarray(run.state.average.table) for run in (whole, cut, other)]
    assert np.array_equal(tables[0], tables[1])
    assert not np.allclose(tables[0], tables[2])
    assert np.array_equal(whole.history["episode_return"], cut.history["episode_return"])
    assert not np.array_equal(whole.history["episode_return"], other.history["episode_return"])


def test_what_was_never_measured_changes_nothing() -> None:
    world, task = make_world(5, (8, 8, 1)), Task(max_steps=50)
    settings = SMALL.changed(rounds=1, flights=2, steps_per_round=6)
    first = train_one(settings, Place(world, task), 0)
    never = np.flatnonzero(np.asarray(first.state.memory.count) == 0)
    assert 0 < never.size < 64
    other_db = np.where(np.isin(np.arange(64), never), np.float32(-20), world.signal.mean_db)
    changed = replace(world, signal=replace(world.signal, mean_db=other_db))
    second = train_one(settings, Place(changed, task), 0)
    for a, b in zip(jax.tree.leaves(first.state), jax.tree.leaves(second.state), strict=True):
        assert np.array_equal(np.asarray(a), np.asarray(b))


def test_an_uncertain_map_is_one_map_during_a_flight() -> None:
    world = make_world(0)
    unknown = Unknown.of(world.grid, np.full(25, 3.0, np.float32), 30.0)
    arena = make_arena(replace(world, signal=replace(world.signal, unknown=unknown)))
    settings = SMALL.changed(flights=200, steps_per_round=5)
    state = fqi_her.initial_state(settings, arena, 0)
    assert float(jnp.std(state.flights.error_db)) == pytest.approx(3.0, rel=0.1)
    flights, memory, _ = collect(jax.random.key(0), settings, arena, Task(max_steps=50), state, jnp.zeros(25))
    same = (np.asarray(flights.error_db) == np.asarray(state.flights.error_db)).all(1)
    assert 0 < same.sum() < 200  # a flight that ended was replaced by one on another map
    measured_db = np.asarray(memory.sum_db / jnp.maximum(memory.count, 1) + memory.first_db)
    assert np.abs(measured_db - world.signal.mean_db)[np.asarray(memory.count) > 0].max() < 3.0
    assert np.asarray(memory.sum_squared_db).sum() / np.asarray(memory.count).sum() > 4.0


def test_rewards_that_distance_does_not_bound_are_refused() -> None:
    with pytest.raises(InputError, match="fqi-her needs"):
        SMALL.check_fits(Task(rho_step=0.1), Grid((0.0, 20.0), (0.0, 20.0), (30.0,)))


def test_a_training_flight_ends_at_its_cap_and_not_a_step_later() -> None:
    world, cap = make_world(0, (8, 8, 1)), 3
    task = Task(max_steps=cap)
    arena = make_arena(world, (0, 0, 0), (7, 7, 0))  # fourteen steps away
    settings = SMALL.changed(steps_per_round=cap)
    state = fqi_her.initial_state(settings, arena, 0)
    penalty = penalty_model(state.memory, task.threshold_db)
    flights, _, statistics = collect(jax.random.key(1), settings, arena, task, state, penalty)
    assert (float(statistics.flights), float(statistics.n_steps), float(statistics.reached)) == (settings.flights, cap, 0.0)
    assert flights.n_steps.tolist() == [0] * settings.flights


def test_a_round_in_which_no_flight_ends_has_no_value() -> None:
    task = Task(max_steps=400)
    arena = Place(make_world(0, (8, 8, 1)), task, (0, 0, 0), (7, 7, 0))
    result = train_one(SMALL.changed(rounds=6, steps_per_round=4, flights=4), arena, 0)
    ended = result.history["flights"] > 0
    assert not ended.all()
    for name in ("episode_return", "n_steps", "reached"):
        np.testing.assert_array_equal(np.isnan(result.history[name]), ~ended)


def test_the_learning_rate_falls_to_its_end_and_is_the_one_that_is_used() -> None:
    settings = SMALL.changed(rounds=100, learning_rate=2e-3, final_learning_rate=1e-30)
    rates = [float(fqi_her.learning_rate_at(settings, jnp.int32(round_))) for round_ in (0, 25, 50, 75, 100)]
    np.testing.assert_allclose(rates, [2e-3, 1.7071e-3, 1e-3, 0.2929e-3, 0.0], atol=1e-7)
    task, arena = Task(max_steps=60), make_arena(make_world(1))
    fresh = fqi_her.initial_state(settings, arena, 0)
    state = jax.jit(fqi_her.run_round, static_argnums=(1, 3))(jax.random.key(0), settings, arena, task, fresh)[0]
    optimize = jax.jit(fqi_her.optimize, static_argnums=(1, 3))
    penalty = penalty_model(state.memory, task.threshold_db)

    def change(round_: int) -> float:
        at = replace(state, round=jnp.int32(round_))
        fitted = optimize(jax.random.key(1), settings, arena, task, at, penalty)
        return float(jnp.abs(fitted.online.weight - state.online.weight).max())

    assert change(99) < 0.1 * change(1)
    assert change(100) == 0.0


def test_hindsight_goals_are_cells_that_a_flight_has_entered() -> None:
    task, arena = Task(max_steps=60), make_arena(make_world(2, (8, 8, 1)))
    settings = SMALL.changed(goals_per_round=6)
    state = fqi_her.initial_state(settings, arena, 0)
    entered = jnp.array([3, 9, 10, 27, 40, 41, 50, 63], jnp.int32)
    state = replace(state, memory=measure(state.memory, entered, jnp.zeros(8)))
    penalty = penalty_model(state.memory, task.threshold_db)
    drawn: set[int] = set()
    for round_ in range(6):
        state = replace(state, round=jnp.int32(round_))
        cache = fqi_her.renew_targets(jax.random.key(round_), settings, arena, task, state, penalty)
        renewed = np.flatnonzero(np.asarray(cache.renewed) == round_ + 1)
        assert len(renewed) == 6
        assert set(renewed.tolist()) <= set(entered.tolist())
        drawn |= set(renewed.tolist())
        state = replace(state, cache=cache)
    assert drawn == set(entered.tolist())
