"""Random (airspace, signal, task) triples: what is expected is the mean of what is drawn, whoever draws it."""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.envs.arena import make_arena
from cellpilot.envs.flight import flight_return, fly
from cellpilot.envs.goal_env import GoalEnv
from cellpilot.envs.vector_env import GoalVectorEnv
from cellpilot.evaluate.evaluation import sampled_flights
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.instances import Instances, all_pairs
from cellpilot.evaluate.metrics import reached_share
from cellpilot.evaluate.summary import summarise
from cellpilot.policies import GreedyPolicy, OptimalPolicy, RandomPolicy
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
N = 6000
TRIPLES = [
    (rule, n_moves, sides, seed)
    for seed, (rule, n_moves, sides) in enumerate(
        [
            ("stay", 4, (4, 3, 1)),
            ("mask", 4, (4, 3, 1)),
            ("end", 4, (4, 3, 1)),
            ("end", 8, (4, 3, 1)),
            ("mask", 8, (4, 3, 1)),
            ("stay", 6, (3, 2, 2)),
            ("end", 26, (3, 2, 2)),
        ]
    )
]


def triple(random_world: MakeWorld, rule: str, n_moves: int, sides: tuple[int, int, int], seed: int) -> tuple[World, Task]:
    world = random_world(
        seed + 20, sides, 0.25, noise_std_db=2.0, sinr_std_db=3.0, rule=rule, n_moves=n_moves, correlation_m=30.0
    )
    rng = np.random.default_rng(seed)
    rewards = dict(zip(("rho_sinr", "rho_step", "rho_blocked", "rho_end"), -rng.uniform(0.2, 2.0, 4).round(2), strict=True))
    return world, Task(rho_goal=5.0, **rewards, threshold_db=3.0, max_steps=25)


def ends_of(world: World) -> tuple[int, int]:
    """A start and a goal that can reach each other."""
    start, goal = world.airspace.draw_pairs(np.random.default_rng(3), 1, *world.airspace.start_goal_cells())
    return int(start[0]), int(goal[0])


def close(returns: np.ndarray, expected: float) -> None:
    assert returns.mean() == pytest.approx(expected, abs=5 * returns.std() / np.sqrt(len(returns)) + 1e-9)


@pytest.mark.parametrize(("rule", "n_moves", "sides", "seed"), TRIPLES)
def test_everybody_draws_what_is_expected(
    random_world: MakeWorld, rule: str, n_moves: int, sides: tuple[int, int, int], seed: int
) -> None:
    world, task = triple(random_world, rule, n_moves, sides, seed)
    start, goal = ends_of(world)
    place, aim = (tuple(int(i) for i in world.grid.position(cell)) for cell in (start, goal))
    policy = RandomPolicy(world)
    exact = exhaustive_summary(np.random.default_rng(0), world, task, policy, place, aim)
    reached = exact.arrivals.sum() / exact.n_flights
    assert 0 < reached < 1

    instances = Instances(np.full(N, start), np.full(N, goal), 0)
    records, _ = sampled_flights(np.random.default_rng(1), world, task, policy, instances)
    for returns in (records.drawn_return, records.expected_return):
        close(returns, exact.return_sum)
    close(records.reached.astype(float), reached)
    close(records.n_steps.astype(float), exact.n_steps)

    arena, offered = make_arena(world), jnp.asarray(world.airspace.offered)

    def once(key: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
        key_flight, key_actions = jax.random.split(key)
        noise = jnp.where(offered[:, None], jax.random.gumbel(key_actions, (task.max_steps, n_moves)), -jnp.inf)
        flight = fly(key_flight, arena, task, jnp.int32(start), jnp.int32(goal), lambda cell, t: noise[cell, t].argmax())
        return flight_return(flight, task), flight.reached, flight.terminated

    returns, arrived, over = (np.asarray(x) for x in jax.jit(jax.vmap(once))(jax.random.split(jax.random.key(0), N)))
    close(returns, exact.return_sum)
    close(arrived.astype(float), reached)
    assert (over != arrived).any() == (rule == "end")

    rng, chances = np.random.default_rng(2), policy.action_probabilities(np.array([goal]))[:, 0]
    env, total = GoalEnv(world, task, start=place, goal=aim), []
    for episode in range(800):
        env.reset(seed=episode)
        here, earned, ended = start, 0.0, False
        while not ended:
            _, reward, terminated, truncated, info = env.step(rng.choice(n_moves, p=chances[here]))
            assert terminated == (info["is_success"] or (rule == "end" and world.airspace.blocked[env._path[-1]]))
            here, earned, ended = env._path[-1], earned + reward, terminated or truncated
        total.append(earned)
    close(np.array(total), exact.return_sum)

    many = GoalVectorEnv(world, task, 500, start=place, goal=aim, autoreset_mode="Disabled")
    many.reset(seed=0)
    sums, running = np.zeros(500), np.ones(500, bool)
    for _ in range(task.max_steps):
        actions = (rng.random(500)[:, None] >= np.cumsum(chances[many._cell], 1)[:, :-1]).sum(1)
        many._over[:] = False  # those that ended fly on unseen
        _, reward, terminated, _, _ = many.step(actions)
        sums += np.where(running, reward, 0.0)
        running &= ~terminated
    close(sums, exact.return_sum)


@pytest.mark.parametrize(("rule", "n_moves", "sides", "seed"), TRIPLES)
def test_exact_figures_of_deterministic_policies_are_those_of_their_flights(
    random_world: MakeWorld, rule: str, n_moves: int, sides: tuple[int, int, int], seed: int
) -> None:
    world, task = triple(random_world, rule, n_moves, sides, seed)
    for policy in (GreedyPolicy(world), OptimalPolicy(world, task)):
        exact = exhaustive_summary(None, world, task, policy)
        pairs = Instances(*all_pairs(world, world.airspace.free_cells), 0)
        records, visits = sampled_flights(np.random.default_rng(0), world, task, policy, pairs)
        flown = summarise(records, visits, world, task, expected=True)
        assert exact.n_flights == flown.n_flights
        for name in ("arrivals", "n_steps", "low_steps", "return_sum", "steps_by_height", "sinr_histogram"):
            np.testing.assert_allclose(getattr(exact, name), getattr(flown, name), rtol=1e-9, atol=1e-9, err_msg=name)
    assert reached_share(exhaustive_summary(None, world, task, GreedyPolicy(world))) == 1


@pytest.mark.parametrize(("rule", "n_moves", "sides", "seed"), TRIPLES)
def test_values_are_what_the_optimum_earns(
    random_world: MakeWorld, rule: str, n_moves: int, sides: tuple[int, int, int], seed: int
) -> None:
    world, task = triple(random_world, rule, n_moves, sides, seed)
    task = replace(task, discount=1.0, max_steps=200)
    goals = world.airspace.free_cells
    starts, goal = all_pairs(world, goals)
    records, _ = sampled_flights(np.random.default_rng(0), world, task, OptimalPolicy(world, task), Instances(starts, goal, 0))
    values = optimal_values(world, task, goals).max(-1)[starts, np.searchsorted(goals, goal)]
    np.testing.assert_allclose(records.expected_return, values, atol=1e-6)
