from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.airspace import STOPPED
from cellpilot.envs.arena import draw_start_and_goal, make_arena
from cellpilot.envs.flight import Flight, flight_return, fly
from cellpilot.errors import InputError
from cellpilot.evaluate.instances import sample_pairs
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]


@pytest.fixture(scope="module")
def fly_actions() -> Callable[..., Flight]:
    """Fly given actions in a compiled environment."""

    def run(key: jax.Array, arena: object, task: Task, start: jax.Array, goal: jax.Array, actions: jax.Array) -> Flight:
        return fly(key, arena, task, start, goal, lambda cell, t: actions[t])

    return jax.jit(run, static_argnames="task")


@pytest.mark.parametrize(
    ("sides", "share"), [((4, 3, 1), 0.0), ((4, 3, 1), 0.3), ((3, 3, 2), 0.0), ((3, 3, 2), 0.25), ((5, 1, 1), 0.0)]
)
def test_random_walks_against_plain_python(
    random_world: MakeWorld, plain: Callable, fly_actions: Callable[..., Flight], sides: tuple[int, int, int], share: float
) -> None:
    task = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-3.0, threshold_db=2.0, max_steps=25)
    ends = Counter()
    for seed in range(12):
        world = random_world(seed, sides, share)
        reference = plain(world)
        rng = np.random.default_rng(seed)
        start, goal = rng.choice(world.airspace.free_cells, 2, replace=False)
        actions = rng.integers(0, world.airspace.n_actions, task.max_steps)
        flight = fly_actions(
            jax.random.key(seed), make_arena(world), task, jnp.int32(start), jnp.int32(goal), jnp.asarray(actions, jnp.int32)
        )
        here, total = reference.positions[start], 0.0
        for t, action in enumerate(actions):
            there, stopped = reference.step(here, int(action))
            next_cell = reference.cell(there)
            row = jax.tree.map(lambda field, t=t: field[t].item(), flight.transitions)
            measured_db = pytest.approx(float(world.signal.mean_db[next_cell]))
            assert row[:4] == (reference.cell(here), action, next_cell, measured_db)
            assert (row.event == STOPPED) == stopped
            total += -0.25 - 1.5 * (world.signal.mean_db[next_cell] < 2.0) - 3.0 * stopped + 7.0 * (next_cell == goal)
            here = there
            if next_cell == goal:
                break
        assert int(flight.n_steps) == t + 1
        assert bool(flight.terminated) == (reference.cell(here) == goal)
        assert int(flight.goal) == goal
        assert float(flight_return(flight, task)) == pytest.approx(total, abs=1e-3)
        ends[bool(flight.terminated)] += 1
    assert ends[True]
    assert ends[False]


def test_the_cap_truncates_and_the_goal_on_the_last_step_terminates(
    make_world: MakeWorld, fly_actions: Callable[..., Flight]
) -> None:
    arena = make_arena(make_world((6, 1, 1)))
    east = jnp.full(10, 2, jnp.int32)
    for max_steps, n_steps, terminated in ((4, 4, False), (5, 5, True), (6, 5, True)):
        flight = fly_actions(jax.random.key(0), arena, Task(max_steps=max_steps), jnp.int32(0), jnp.int32(5), east)
        assert (int(flight.n_steps), bool(flight.terminated)) == (n_steps, terminated)


def test_noise_is_drawn_at_every_step_with_its_mean_and_spread(make_world: MakeWorld, fly_actions: Callable[..., Flight]) -> None:
    task = Task(max_steps=5_000)
    world = make_world((3, 3, 1), 5.0, noise_std_db=2.0)
    north = jnp.zeros(task.max_steps, jnp.int32)
    flight = fly_actions(jax.random.key(1), make_arena(world), task, jnp.int32(0), jnp.int32(8), north)
    deviation = np.asarray(flight.transitions.sinr_db) - 5.0
    assert abs(deviation.mean()) < 5 * 2.0 / np.sqrt(task.max_steps)
    assert deviation.std() == pytest.approx(2.0, abs=5 * 2.0 / np.sqrt(2 * task.max_steps))
    assert abs(np.corrcoef(deviation[:-1], deviation[1:])[0, 1]) < 5 / np.sqrt(task.max_steps)


def test_what_is_unknown_of_the_map_is_drawn_once_per_flight(make_world: MakeWorld, fly_actions: Callable[..., Flight]) -> None:
    task = Task(max_steps=20)
    world = make_world((4, 1, 1), 5.0, sinr_std_db=[1.0, 3.0, 1.0, 1.0])
    back_and_forth = jnp.asarray([2, 3] * 10, jnp.int32)  # cells 1, 0, 1, 0, ...
    arena = make_arena(world)
    run = jax.jit(jax.vmap(lambda key: fly_actions(key, arena, task, jnp.int32(0), jnp.int32(3), back_and_forth)))
    sinr = np.asarray(run(jax.random.split(jax.random.key(2), 2_000)).transitions.sinr_db)
    assert np.ptp(sinr[:, 0::2], axis=1).max() == 0  # one cell, one flight: always the same
    assert np.ptp(sinr[:, 1::2], axis=1).max() == 0
    assert sinr[:, 0].std() == pytest.approx(3.0, rel=0.1)
    assert sinr[:, 1].std() == pytest.approx(1.0, rel=0.1)
    assert abs(np.corrcoef(sinr[:, 0], sinr[:, 1])[0, 1]) < 0.15


@pytest.mark.parametrize("sides", [(5, 4, 1), (3, 4, 2)])
def test_network_inputs_are_positions_over_sides(make_world: MakeWorld, sides: tuple[int, int, int]) -> None:
    world = make_world(sides)
    coordinates = np.asarray(make_arena(world).coordinates)
    dimensions = 2 if sides[2] == 1 else 3
    assert coordinates.shape == (world.grid.n_cells, dimensions)
    for cell in range(world.grid.n_cells):
        expected = [(i + 1) / n for i, n in zip(world.grid.position(cell), sides, strict=True)][:dimensions]
        np.testing.assert_allclose(coordinates[cell], expected, rtol=1e-6)


BLOCKED = {
    "one part": [],
    "two parts": [(2, 0, 0), (2, 1, 0), (2, 2, 0)],
    "unequal parts and a lonely cell": [(1, 0, 0), (1, 1, 0), (1, 2, 0), (4, 0, 0), (4, 1, 0), (3, 2, 0), (5, 1, 0)],
}


@pytest.mark.parametrize("blocked", BLOCKED.values(), ids=BLOCKED.keys())
@pytest.mark.parametrize(("start", "goal"), [(None, None), ((0, 0, 0), None), (None, (3, 0, 0)), ((0, 0, 0), (0, 2, 0))])
def test_pairs_are_uniform_over_different_cells_that_can_reach_each_other(
    make_world: MakeWorld,
    plain: Callable,
    blocked: list[tuple[int, int, int]],
    start: tuple[int, int, int] | None,
    goal: tuple[int, int, int] | None,
) -> None:
    world = make_world((6, 3, 1), blocked=blocked)
    reference = plain(world)
    pairs = {
        (reference.cell(s), reference.cell(g))
        for part in reference.parts()
        for s in part
        for g in part
        if s != g and (start is None or s == start) and (goal is None or g == goal)
    }
    n = 60 * len(pairs) + 200
    arena = make_arena(world, start, goal)
    compiled = jax.jit(jax.vmap(draw_start_and_goal, (0, None)))(jax.random.split(jax.random.key(3), n), arena)
    plain_draws = sample_pairs(np.random.default_rng(3), world, n, start, goal)
    for starts, goals in (compiled, (plain_draws.start, plain_draws.goal)):
        counts = Counter(zip(np.asarray(starts).tolist(), np.asarray(goals).tolist(), strict=True))
        assert set(counts) <= pairs
        expected = n / len(pairs)
        chi_square = sum((counts[pair] - expected) ** 2 / expected for pair in pairs)
        freedom = len(pairs) - 1
        assert chi_square <= freedom + 5 * np.sqrt(2 * freedom) + 1e-9


def test_unusable_starts_are_refused(make_world: MakeWorld) -> None:
    world = make_world((5, 2, 1), blocked=[(2, 0, 0), (2, 1, 0)])
    for start, goal in (((2, 0, 0), None), ((0, 0, 0), (4, 0, 0)), ((0, 0, 0), (0, 0, 0))):
        with pytest.raises(InputError):
            make_arena(world, start, goal)


def test_another_world_of_the_same_size_needs_no_compilation(random_world: MakeWorld) -> None:
    traces = []

    @jax.jit
    def run(arena: object, key: jax.Array, start: jax.Array, goal: jax.Array) -> jax.Array:
        traces.append(None)
        return fly(key, arena, Task(max_steps=9), start, goal, lambda cell, t: cell % 4).n_steps

    for seed, noise in ((0, 0.0), (1, 2.0), (2, 3.5)):
        world = random_world(seed, (4, 4, 1), noise_std_db=noise)
        run(make_arena(world), jax.random.key(seed), jnp.int32(seed), jnp.int32(15))
    assert len(traces) == 1
    run(make_arena(random_world(0, (5, 4, 1))), jax.random.key(0), jnp.int32(0), jnp.int32(15))
    assert len(traces) == 2


def test_flights_depend_on_key_and_nothing_else(random_world: MakeWorld, fly_actions: Callable[..., Flight]) -> None:
    world = random_world(4, (4, 4, 1), noise_std_db=2.0)
    task = Task(max_steps=30)
    actions = jnp.asarray(np.random.default_rng(0).integers(0, 4, 30), jnp.int32)
    run = lambda seed, world: fly_actions(jax.random.key(seed), make_arena(world), task, jnp.int32(0), jnp.int32(15), actions)
    first, again, other = (np.asarray(run(seed, world).transitions.sinr_db) for seed in (0, 0, 1))
    quiet = np.asarray(run(0, replace(world, signal=replace(world.signal, noise_std_db=0.0))).transitions.sinr_db)
    np.testing.assert_array_equal(first, again)
    assert (first != other).all()
    assert (first != quiet).all()
