"""Random (airspace, signal, task) triples: what is expected is the mean of what is drawn, whoever draws it.

One table of drawn rewards, worked out here by equation 4.4 as the thesis prints it, holds the task to it; environments,
evaluations, solvers and the targets of learners are held to the table, or to one another. Every task has two rewards of
its own, a price each.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.airspace import ENTERED, STOPPED
from cellpilot.envs.arena import Arena, make_arena
from cellpilot.envs.flight import Flight, flight_return, fly
from cellpilot.envs.goal_env import GoalEnv
from cellpilot.envs.vector_env import GoalVectorEnv
from cellpilot.evaluate.evaluation import sampled_flights
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.instances import Instances, all_pairs
from cellpilot.evaluate.metrics import reached_share
from cellpilot.evaluate.summary import summarise
from cellpilot.grid import Position
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.fqi_her_targets import pair_values, targets
from cellpilot.learn.algorithms.map_learner import MapLearner, receiver
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.losses import q_learning_target
from cellpilot.learn.n_step import outcome_of_steps
from cellpilot.learn.pair_network import PairNetwork
from cellpilot.learn.penalty import CellMeasurements, measure, no_measurements, penalty_model
from cellpilot.learn.replay import Experience, Replay
from cellpilot.policies import GreedyPolicy, OptimalPolicy, Policy, RandomPolicy
from cellpilot.policies.base import one_hot
from cellpilot.solve import optimal_values, values
from cellpilot.task import Price, Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
N, DRAWS, STEPS = 4000, 200_000, 25
PLAIN = [
    ("stay", 4, (4, 3, 1)),
    ("mask", 4, (4, 3, 1)),
    ("end", 4, (4, 3, 1)),
    ("end", 8, (4, 3, 1)),
    ("mask", 8, (4, 3, 1)),
    ("stay", 6, (3, 2, 2)),
    ("end", 26, (3, 2, 2)),
]
OWN = (
    Price("northwards", -0.4, "move", lambda move: move.action == 0),
    Price("even cells", -0.3, "entering", lambda entering: entering.cell % 2 == 0),
)


@dataclass(frozen=True)
class Case:
    """A triple, and a start and a goal in it that can reach each other."""

    world: World
    task: Task
    start: int
    goal: int

    @property
    def places(self) -> tuple[Position, Position]:
        start, goal = ((int(x), int(y), int(z)) for x, y, z in self.world.grid.position(np.array([self.start, self.goal])))
        return start, goal

    @cached_property
    def arena(self) -> Arena:
        return make_arena(self.world)

    @cached_property
    def flights(self) -> Flight:
        """Flights of the compiled environment at random; fields `[N, ...]`."""
        offered = jnp.asarray(self.world.airspace.offered)

        def once(key: jax.Array) -> Flight:
            key_flight, key_actions = jax.random.split(key)
            noise = jax.random.gumbel(key_actions, (STEPS, offered.shape[1]))
            choose = lambda cell, t: jnp.where(offered[cell], noise[t], -jnp.inf).argmax()
            return fly(key_flight, self.arena, self.task, jnp.int32(self.start), jnp.int32(self.goal), choose)

        return jax.jit(jax.vmap(once))(jax.random.split(jax.random.key(0), 2 * N))

    @cached_property
    def alive(self) -> np.ndarray:
        """Cells from which a flight to the goal can be under way."""
        part = self.world.airspace.part
        return (part == part[self.goal]) & (np.arange(part.size) != self.goal)

    def measured_db(self, n: int) -> np.ndarray:
        """CellMeasurements `[n, n_cells]`, each of a map and a noise of its own."""
        rng, size = np.random.default_rng(5), (n, self.world.grid.n_cells)
        noise_db = self.world.signal.noise_std_db * rng.standard_normal(size, np.float32)
        return self.world.signal.mean_db + self.world.signal.unknown.draw(rng.standard_normal(size, np.float32)) + noise_db

    @cached_property
    def low(self) -> np.ndarray:
        """Share of drawn measurements below the threshold, `[n_cells]`."""
        return (self.measured_db(DRAWS) < self.task.threshold_db).mean(0)

    def plain_rewards(self, low: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Equation 4.4 with the prices of forbidden moves, for all cells and actions: reward, next cell, flight over."""
        task, airspace = self.task, self.world.airspace
        cell, action = np.arange(airspace.grid.n_cells)[:, None], np.arange(airspace.n_actions)
        next_cell, event = airspace.step(cell, action)
        reward = task.rho_step + task.rho_goal * (next_cell == self.goal) + task.rho_sinr * low[next_cell]
        reward = reward + task.rho_blocked * (event == STOPPED) + task.rho_end * (event == ENTERED)
        if task.more:
            reward = reward - 0.4 * (action == 0) - 0.3 * (next_cell % 2 == 0)
        reward = np.where(airspace.offered, reward, -np.inf)
        return reward, next_cell, (next_cell == self.goal) | airspace.blocked[next_cell]

    def plain_values(self, low: np.ndarray, discount: float) -> np.ndarray:
        """Values `[n_cells, actions]` by backing drawn rewards up, as often as any flight has steps."""
        reward, next_cell, over = self.plain_rewards(low)
        found = np.full(reward.shape, -1e9)
        for _ in range(150):
            found = reward + np.where(over, 0.0, discount * found.max(1)[next_cell])
        return found


@pytest.fixture(scope="module", params=range(len(PLAIN)), ids=["-".join(map(str, plain[:2])) for plain in PLAIN])
def case(request: pytest.FixtureRequest, random_world: MakeWorld) -> Case:
    seed = request.param
    rule, n_moves, sides = PLAIN[seed]
    world = random_world(
        seed + 20,
        sides,
        0.25,
        noise_std_db=2.0,
        sinr_std_db=3.0,
        rule=rule,
        n_moves=n_moves,
        correlation_m=30.0,
        common_std_db=1.5,
    )
    names = ("rho_sinr", "rho_step", "rho_blocked", "rho_end")
    rewards = dict(zip(names, -np.random.default_rng(seed).uniform(0.2, 2.0, 4).round(2), strict=True))
    task = Task(rho_goal=5.0, **rewards, threshold_db=3.0, discount=0.9, max_steps=STEPS, more=OWN)
    start, goal = world.airspace.draw_pairs(np.random.default_rng(3), 1, *world.airspace.start_goal_cells())
    return Case(world, task, int(start[0]), int(goal[0]))


def close(drawn: np.ndarray, expected: float) -> None:
    assert drawn.mean() == pytest.approx(expected, abs=5 * drawn.std() / np.sqrt(len(drawn)) + 1e-9)


def close_in_each(group: np.ndarray, drawn: np.ndarray, std: float | np.ndarray) -> None:
    """The mean of independent draws in each group is 0; `std` is that of one draw, by group, or a bound for all of them."""
    sums, count = np.bincount(group, drawn), np.bincount(group)
    most = std if isinstance(std, float) else std[: len(count)]
    assert (np.abs(sums) <= 5 * most * np.sqrt(count) + 1e-3).all()


def test_the_expected_outcome_is_the_mean_of_drawn_ones(case: Case) -> None:
    """The table of drawn rewards, against the task in expectation; both against the task for each drawn flight."""
    reward, _, over = case.plain_rewards(case.low)
    cell, action = np.arange(reward.shape[0])[:, None], np.arange(reward.shape[1])
    found = case.task.expected_outcome(case.world, cell, action, case.goal)
    offered = case.world.airspace.offered
    # A share of 200,000 draws is within 0.0056 of its chance, five standard deviations.
    np.testing.assert_allclose(found.reward[offered], reward[offered], atol=0.0056 * -case.task.rho_sinr + 1e-6)
    np.testing.assert_array_equal(found.terminated[case.alive], over[case.alive])
    step, row = np.arange(STEPS), np.arange(2 * N)
    facts, real = case.flights.transitions, step < np.asarray(case.flights.n_steps)[:, None]
    drawn = np.asarray(case.task.outcome(facts, case.goal).reward)
    low = np.asarray(facts.sinr_db) < case.task.threshold_db
    plain = case.plain_rewards(np.zeros(reward.shape[0]))[0][np.asarray(facts.cell), np.asarray(facts.action)]
    np.testing.assert_allclose(drawn[real], (plain + case.task.rho_sinr * low)[real], atol=1e-5)
    one = (row, (np.random.default_rng(0).random(2 * N) * real.sum(1)).astype(int))  # of each flight, since it has one map
    entered = np.asarray(facts.next_cell)[one]
    close_in_each(entered, low[one] - case.low[entered], 0.5)
    total, (least, greatest) = (drawn * real * 0.9**step).sum(1), case.task.value_bounds(case.world.airspace.ends)
    assert (total[row] >= least).all()
    assert (total[row] <= greatest).all()


def test_environments_and_evaluations_draw_what_is_expected(case: Case) -> None:
    world, task, policy = case.world, case.task, RandomPolicy(case.world)
    exact = exhaustive_summary(np.random.default_rng(0), world, task, policy, *case.places)
    reached = exact.arrivals.sum() / exact.n_flights
    assert 0 < reached < 1

    instances = Instances(np.full(N, case.start), np.full(N, case.goal), 0)
    records, _ = sampled_flights(np.random.default_rng(1), world, task, policy, instances)
    for returns in (records.drawn_return, records.expected_return):
        close(returns, exact.return_sum)
    close(records.reached.astype(float), reached)
    close(records.n_steps.astype(float), exact.n_steps)
    close(records.low_steps.astype(float), exact.low_steps)

    flights = case.flights
    close(np.asarray(jax.jit(jax.vmap(lambda flight: flight_return(flight, task)))(flights)), exact.return_sum)
    close(np.asarray(flights.reached).astype(float), reached)
    close(np.asarray(flights.n_steps).astype(float), exact.n_steps)
    assert (flights.terminated != flights.reached).any() == (world.airspace.rule == "end")


def test_gymnasium_environments_draw_what_is_expected(case: Case) -> None:
    world, task, (place, aim), policy = case.world, case.task, case.places, RandomPolicy(case.world)
    exact = exhaustive_summary(np.random.default_rng(0), world, task, policy, place, aim)
    rng, chances = np.random.default_rng(2), policy.action_probabilities(np.array([case.goal]))[:, 0]
    env, total, arrived, first = GoalEnv(world, task, start=place, goal=aim), [], [], []
    for episode in range(800):
        env.reset(seed=episode)
        here, earned, ended = case.start, 0.0, False
        while not ended:
            _, reward, terminated, truncated, info = env.step(rng.choice(chances.shape[1], p=chances[here]))
            assert terminated == (info["is_success"] or (world.airspace.ends and world.airspace.blocked[env._path[-1]]))
            if len(env._path) == 2:
                off = reward - task.expected_outcome(world, here, info["action"], case.goal).reward
                first.append((env._path[-1], off))
            here, earned, ended = env._path[-1], earned + reward, terminated or truncated
        total.append(earned)
        arrived.append(info["is_success"])
    close(np.array(total), exact.return_sum)
    close(np.array(arrived, float), exact.arrivals.sum())
    entered, off = zip(*first, strict=True)
    close_in_each(np.array(entered), np.array(off), -task.rho_sinr / 2)

    n, low = 6_000, world.outage_probability(task.threshold_db).astype(float)
    many = GoalVectorEnv(world, task, n, start=place, goal=aim, autoreset_mode="Disabled")
    many.reset(seed=0)
    other = int(np.flatnonzero(case.alive)[-1])  # a goal of hindsight
    sums, running, success = np.zeros(n), np.ones(n, bool), np.zeros(n, bool)
    for step in range(STEPS):
        actions = (rng.random(n)[:, None] >= np.cumsum(chances[many._cell], 1)[:, :-1]).sum(1)
        many._over[:] = False  # those that ended fly on unseen
        observation, reward, terminated, _, info = many.step(actions)
        if step == 0:
            aims = np.repeat(many.rules.coordinates[other][None], n, 0)
            again = many.compute_reward(observation["achieved_goal"], aims, info)
            for rewards, towards in ((again, other), (reward, case.goal)):
                off = rewards - task.expected_outcome(world, info["cell"], actions, towards).reward
                close_in_each(many._cell, off, -task.rho_sinr * np.sqrt(low * (1 - low)))
        sums += np.where(running, reward, 0.0)
        success |= running & info["is_success"]
        running &= ~terminated
    close(sums, exact.return_sum)
    close(success.astype(float), exact.arrivals.sum())


@dataclass(frozen=True)
class Wandering:
    """A fixed action in every cell, drawn once for each goal: flights loop, are stopped, and end in blocked cells."""

    world: World
    name: str = "wandering"
    deterministic: bool = True

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        offered = self.world.airspace.offered
        chosen = [np.where(offered, np.random.default_rng(int(g)).random(offered.shape), -1).argmax(1) for g in goals]
        return one_hot(np.stack(chosen, 1).astype(np.int8), offered.shape[1])


@pytest.mark.parametrize("kind", ["greedy", "optimal", "wandering"])
def test_exact_figures_of_deterministic_policies_are_those_of_their_flights(case: Case, kind: str) -> None:
    world, task = case.world, case.task
    policy: Policy = {"greedy": GreedyPolicy(world), "optimal": OptimalPolicy(world, task), "wandering": Wandering(world)}[kind]
    exact = exhaustive_summary(None, world, task, policy)
    starts, goals = all_pairs(world, world.airspace.free_cells)
    times = 60
    instances = Instances(np.repeat(starts, times), np.repeat(goals, times), 0)
    flown, visits = sampled_flights(np.random.default_rng(1), world, task, policy, instances)
    found = summarise(flown, visits, world, task, expected=True)
    assert exact.n_flights == len(starts)
    for name in ("arrivals", "n_steps", "low_steps", "return_sum", "steps_by_height", "sinr_histogram"):
        expected = getattr(found, name) / times
        np.testing.assert_allclose(getattr(exact, name), expected, rtol=1e-9, atol=1e-9, err_msg=name)
    drawn, expected = (values.reshape(-1, times) for values in (flown.drawn_return, flown.expected_return))
    off = (drawn - expected).mean(1)
    assert (np.abs(off) <= 5 * drawn.std(1) / np.sqrt(times) + 0.25 * -task.rho_sinr).all()
    close(flown.drawn_return - flown.expected_return, 0.0)
    if kind == "greedy":
        assert reached_share(exact) == 1
    if kind == "wandering" and world.airspace.ends:
        assert (~flown.reached & (flown.n_steps < STEPS)).any()  # some did end in a blocked cell


SOLVERS = {"value iteration": (0.9, 10**9), "policy iteration": (0.4, 0), "cheapest paths": (1.0, 10**9)}
"""Discount, and above how many cells policies are iterated; with 0.4 the cheapest paths, which they begin with, are not best."""


@pytest.mark.parametrize("solver", SOLVERS)
def test_solvers_find_the_values_of_drawn_rewards(case: Case, solver: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where flights end in blocked cells all of them are value iteration, without discount too."""
    discount, large_cells = SOLVERS[solver]
    monkeypatch.setattr(values, "LARGE_CELLS", large_cells)
    goals = case.world.airspace.free_cells
    found = optimal_values(case.world, case.task, goals, discount)
    for column, goal in enumerate(goals.tolist()):
        aimed = replace(case, goal=goal)
        best = aimed.plain_values(case.low, discount)
        np.testing.assert_allclose(found[aimed.alive, column], best[aimed.alive], atol=0.02)


def test_the_optimum_earns_its_values(case: Case) -> None:
    task = replace(case.task, discount=1.0, max_steps=200)
    goals = case.world.airspace.free_cells
    starts, goal = all_pairs(case.world, goals)
    instances = Instances(starts, goal, 0)
    flown, _ = sampled_flights(np.random.default_rng(0), case.world, task, OptimalPolicy(case.world, task), instances)
    best = optimal_values(case.world, task, goals).max(-1)[starts, np.searchsorted(goals, goal)]
    np.testing.assert_allclose(flown.expected_return, best, atol=1e-6)


@pytest.mark.parametrize("n_steps", [1, 3])
def test_the_target_of_ddqn_her_is_the_expected_one_on_average(case: Case, n_steps: int) -> None:
    """Facts of drawn flights, replayed for hindsight goals; one experience of each flight, since a flight has one map."""
    world, task, flights = case.world, case.task, case.flights
    keys = jax.random.split(jax.random.key(1), 2 * N)
    draw = jax.vmap(lambda key, flight: hindsight_goals(key, flight, 1, "future", world.airspace.ends)[:, 0])
    goals, lengths = jax.jit(draw)(keys, flights), np.asarray(flights.n_steps)
    left = flights.n_steps[:, None] - jnp.arange(STEPS)
    whole = Experience(flights.transitions, goals, left)
    replay = Replay(jax.tree.map(jnp.ravel, whole), jnp.int32(0), jnp.int32(2 * N * STEPS))
    rng, flight = np.random.default_rng(0), np.arange(2 * N)
    t = (rng.random(2 * N) * lengths).astype(int)
    online, target = rng.normal(0, 5, (2, world.grid.n_cells, world.airspace.n_actions)).astype(np.float32)
    not_offered = np.where(world.airspace.offered, 0, -np.inf).astype(np.float32)

    rows = jnp.asarray(flight * STEPS + t)
    drawn = jax.jit(lambda replay: outcome_of_steps(replay, rows, task, n_steps, 1))(replay)
    discount = task.discount if drawn.discount is None else drawn.discount
    tables = (jnp.asarray(table)[drawn.next_cell] for table in (online, target))
    masked = jnp.asarray(not_offered)[drawn.next_cell] if world.airspace.rule == "mask" else None
    found = q_learning_target(drawn.reward, drawn.terminated, *tables, discount, True, masked)

    cell, action, goal = (
        np.asarray(flights.transitions.cell),
        np.asarray(flights.transitions.action),
        np.asarray(goals)[flight, t],
    )
    total, factor, going, last = np.zeros(2 * N), np.ones(2 * N), np.ones(2 * N, bool), np.zeros(2 * N, int)
    for at in range(n_steps):
        there = np.minimum(t + at, STEPS - 1)
        flown = going & (t + at < lengths)
        expected = task.expected_outcome(world, cell[flight, there], action[flight, there], goal)
        total += np.where(flown, factor * expected.reward, 0.0)
        last = np.where(flown, world.airspace.step(cell[flight, there], action[flight, there])[0], last)
        factor *= np.where(flown, 0.9, 1.0)
        going &= ~(flown & expected.terminated)
    best = (online + not_offered)[last].argmax(-1)
    total += np.where(going, factor * target[last, best], 0.0)

    off, group = np.asarray(found) - total, cell[flight, t] * world.airspace.n_actions + action[flight, t]
    close_in_each(group, off, -task.rho_sinr / 2 * n_steps)
    close(off, 0.0)


@pytest.fixture(scope="module")
def measured(case: Case) -> tuple[Case, CellMeasurements]:
    """The triple without rewards of its own, which FQI-HER refuses, and 2,000 measurements of every cell."""
    cells = jnp.arange(case.world.grid.n_cells)
    add = lambda memory, sinr_db: (measure(memory, cells, sinr_db), None)
    memory, _ = jax.lax.scan(add, no_measurements(len(cells), 2000), jnp.asarray(case.measured_db(2000), jnp.float32))
    return replace(case, task=replace(case.task, more=())), memory


def network_of(case: Case) -> PairNetwork:
    return PairNetwork(case.world.grid.sides, 4, 2, jax.random.key(4))


def test_the_targets_of_fqi_her_with_a_penalty_model_are_the_values_of_drawn_rewards(
    measured: tuple[Case, CellMeasurements],
) -> None:
    case, memory = measured
    learned = np.asarray(jax.jit(penalty_model, static_argnums=1)(memory, case.task.threshold_db))
    np.testing.assert_allclose(learned, case.low, atol=0.06)
    settings, chance = FQIHER(sweeps=100), jnp.asarray(case.low, jnp.float32)
    goals = jnp.array([case.goal], jnp.int32)
    arena = case.arena
    backed_up = lambda network: targets(jax.random.key(0), settings, arena, case.task, network, memory, chance, goals)[0]
    found = jax.jit(backed_up)(network_of(case))
    np.testing.assert_allclose(found[case.alive, 0], case.plain_values(case.low, 0.9).max(1)[case.alive], atol=1e-3)


def test_the_targets_of_fqi_her_without_a_model_are_the_expected_ones_on_average(
    measured: tuple[Case, CellMeasurements],
) -> None:
    """The value of entering a cell: what entering earns, and the best further move with the network behind it."""
    case, memory = measured
    task, settings, network = case.task, FQIHER(penalty_model=False, look_ahead=1), network_of(case)
    goals, free = jnp.array([case.goal], jnp.int32), ~case.world.airspace.blocked
    arena = case.arena
    one = lambda key: targets(key, settings, arena, task, network, memory, jnp.zeros(len(free)), goals)[0][:, 0]
    found = jax.jit(jax.vmap(one))(jax.random.split(jax.random.key(2), 2000)).mean(0)
    behind, bound = pair_values(network, case.arena, task, None, jnp.arange(len(free)), jnp.int32(case.goal))
    least = np.minimum(np.asarray(behind).min(0), bound)
    reward, next_cell, _ = case.plain_rewards(np.zeros(len(free)))
    at_goal = np.arange(len(free)) == case.goal
    of_move = reward - task.rho_step - task.rho_goal * (next_cell == case.goal)
    entering = task.rho_step + task.rho_goal * at_goal + task.rho_sinr * case.low
    expected = entering + np.where(at_goal, 0.0, 0.9 * (of_move + least[next_cell]).max(1))
    np.testing.assert_allclose(found[free], expected[free], atol=5 * 0.5 * np.sqrt(2 / 2000) * -task.rho_sinr)


def test_the_plan_of_the_map_learner_is_the_best_for_maps_drawn_from_its_belief(case: Case) -> None:
    learner = MapLearner(case.world.airspace, case.task, MapLearning(optimism=0.0, discount=0.9), 0)
    for flight in range(2):
        flown = learner.fly(case.start, case.goal, receiver(case.world, 0, flight))
        entered = flown.transitions.next_cell
        assert flown.reached == (entered[-1] == case.goal)
        assert flown.reached or len(entered) == STEPS or case.world.airspace.blocked[entered[-1]]
    rng, belief, n = np.random.default_rng(0), learner.posterior, 10_000
    noise_db = belief.kernel.noise_std_db * rng.standard_normal((n, len(case.alive)))
    maps_db = np.stack([belief.sample(rng) for _ in range(n)])
    exploring = (belief.mean_db + noise_db < case.task.threshold_db).mean(0)
    believed = (maps_db + noise_db < case.task.threshold_db).mean(0)
    policy = learner.policy().action_probabilities(np.array([case.goal]))[:, 0].argmax(1)
    for actions, low in ((learner.plan(case.goal, rng), exploring), (policy, believed)):
        best = case.plain_values(low, 0.9)
        chosen = np.take_along_axis(best, actions[:, None].astype(int), 1)[:, 0]
        np.testing.assert_allclose(chosen[case.alive], best.max(1)[case.alive], atol=0.05)
    world = learner.believed_world()
    np.testing.assert_allclose(world.outage_probability(case.task.threshold_db), believed, atol=0.02)
