"""The learner of the map: it learns from its own measurements alone, arrives from the first flight on, and repeats."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import reached_share, return_mean, score
from cellpilot.learn.algorithms.map_learner import MapLearner, learn_map
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.maps.estimate.gaussian_process import Kernel
from cellpilot.policies import GreedyPolicy, OptimalPolicy
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
TASK = Task(max_steps=160)
FAST = MapLearning(replan_every_steps=4, estimate_after_flights=(2, 4))


def smooth_world(make_world: MakeWorld, sides: tuple[int, int, int] = (8, 8, 1), noise_std_db: float = 0.0) -> World:
    """Two hills of SINR with a bad valley between them; better below than above."""
    z, y, x = np.meshgrid(*(np.arange(n) for n in sides[::-1]), indexing="ij")
    sinr_db = 3 + 8 * np.cos(2 * np.pi * x / (sides[0] - 1)) + 2 * np.sin(y) - 4 * z
    return make_world(sides, sinr_db.ravel(), noise_std_db=noise_std_db)


def last(world: World, flights: int, seed: int, settings: MapLearning = FAST, prior: np.ndarray | None = None) -> MapLearner:
    """The learner after so many flights."""
    return list(learn_map(world, TASK, settings, seed, [flights], prior))[-1]


def assert_identical(one: MapLearner, other: MapLearner) -> None:
    """Everything known is equal, bit for bit."""
    assert one.measured_cells == other.measured_cells
    assert one.measured_db == other.measured_db
    assert one.posterior.kernel == other.posterior.kernel
    assert one.posterior.mean_db.tobytes() == other.posterior.mean_db.tobytes()
    assert one.posterior.covariance_db2.tobytes() == other.posterior.covariance_db2.tobytes()
    goals = np.arange(one.grid.n_cells)
    assert one.policy().actions(goals).tobytes() == other.policy().actions(goals).tobytes()


@pytest.mark.parametrize("exploration", ["optimism", "thompson"])
@pytest.mark.parametrize("noise_db", [0.0, 2.0])
def test_the_truth_of_unvisited_cells_changes_nothing(make_world: MakeWorld, exploration: str, noise_db: float) -> None:
    world = smooth_world(make_world, noise_std_db=noise_db)
    settings = FAST.changed(exploration=exploration)
    found = last(world, 5, 0, settings)
    unvisited = np.setdiff1d(world.airspace.free_cells, found.measured_cells)
    assert unvisited.size
    other_db = world.signal.mean_db.copy()
    other_db[unvisited] += np.where(np.arange(unvisited.size) % 2, 40, -40).astype(np.float32)
    assert_identical(last(replace(world, signal=replace(world.signal, mean_db=other_db)), 5, 0, settings), found)
    # What was visited does count.
    other_db = world.signal.mean_db.copy()
    other_db[found.measured_cells[0]] += np.float32(1.0)
    assert (
        last(replace(world, signal=replace(world.signal, mean_db=other_db)), 5, 0, settings).posterior.mean_db
        != found.posterior.mean_db
    ).any()


@pytest.mark.parametrize("exploration", ["optimism", "thompson"])
def test_equal_seeds_are_equal_and_two_seeds_differ(make_world: MakeWorld, exploration: str) -> None:
    world = smooth_world(make_world, noise_std_db=1.0)
    settings = FAST.changed(exploration=exploration)
    assert_identical(last(world, 5, 3, settings), last(world, 5, 3, settings))
    one, other = last(world, 5, 3, settings), last(world, 5, 4, settings)
    assert one.measured_cells != other.measured_cells
    assert (one.posterior.mean_db != other.posterior.mean_db).any()
    goals = np.arange(world.grid.n_cells)
    assert (one.policy().actions(goals) != other.policy().actions(goals)).any()


def test_later_flights_and_checkpoints_change_no_earlier_flight(make_world: MakeWorld) -> None:
    world = smooth_world(make_world, noise_std_db=1.0)
    steps = [(learner.n_flights, len(learner.measured_cells)) for learner in learn_map(world, TASK, FAST, 0, [1, 2, 6])]
    assert [flights for flights, _ in steps] == [1, 2, 6]
    assert len(last(world, 2, 0).measured_cells) == steps[1][1]
    assert_identical(last(world, 6, 0), list(learn_map(world, TASK, FAST, 0, [1, 2, 6]))[-1])


@pytest.mark.parametrize(("sides", "noise_db"), [((8, 8, 1), 0.0), ((8, 8, 1), 2.0), ((5, 5, 3), 2.0)])
def test_every_pair_arrives_from_the_first_flight_on(make_world: MakeWorld, sides: tuple[int, int, int], noise_db: float) -> None:
    world = smooth_world(make_world, sides, noise_db)
    for seed in (0, 1):
        for learner in learn_map(world, TASK, FAST, seed, [1, 2, 3, 6]):
            assert reached_share(exhaustive_summary(None, world, TASK, learner.policy())) == 1.0


@pytest.mark.parametrize("exploration", ["optimism", "thompson"])
def test_it_gets_near_the_optimum(make_world: MakeWorld, exploration: str) -> None:
    world = smooth_world(make_world, (10, 10, 1))
    greedy, optimal = (exhaustive_summary(None, world, TASK, p) for p in (GreedyPolicy(world), OptimalPolicy(world, TASK)))
    found = []
    for seed in range(3):
        learner = last(world, 20, seed, FAST.changed(exploration=exploration))
        found.append(score(exhaustive_summary(None, world, TASK, learner.policy()), greedy, optimal))
    assert np.mean(found) > 0.95


def test_noise_is_estimated(make_world: MakeWorld) -> None:
    for noise_db in (0.0, 3.0):
        world = smooth_world(make_world, (10, 10, 1), noise_db)
        learner = last(world, 20, 0, FAST.changed(estimate_after_flights=(20,)))
        assert learner.posterior.kernel.noise_std_db == pytest.approx(max(noise_db, 0.1), rel=0.25, abs=0.2)
        error_db = learner.believed_world().signal.mean_db - world.signal.mean_db
        assert np.abs(error_db[learner.measured_cells]).mean() < (0.1 if noise_db == 0 else 2.0)


def test_a_plan_for_one_goal_is_exact_on_the_optimistic_map(make_world: MakeWorld) -> None:
    world = smooth_world(make_world, noise_std_db=1.0)
    settings = FAST.changed(optimism=1.5)
    learner = last(world, 2, 0, settings)
    believed = learner.believed_world()
    hopeful_db = believed.signal.mean_db + np.float32(1.5) * believed.signal.std_db
    hopeful = replace(believed, signal=replace(believed.signal, mean_db=hopeful_db, unknown=None))
    for goal in (0, 37):
        expected = OptimalPolicy.undiscounted(hopeful, TASK)
        tables = [
            exhaustive_summary(None, hopeful, TASK, policy, goals=np.array([goal]))
            for policy in (expected, _Table(learner.plan(goal, np.random.default_rng(0)), world.airspace.n_actions))
        ]
        assert return_mean(tables[1]) == pytest.approx(return_mean(tables[0]), abs=1e-4)


class _Table:
    """Actions `[n_cells]` for a single goal."""

    name, deterministic = "table", True

    def __init__(self, actions: np.ndarray, n_actions: int):
        self.rows = np.eye(n_actions, dtype=np.float32)[actions][:, None]

    def action_probabilities(self, goals: np.ndarray) -> np.ndarray:
        return self.rows


def test_blocked_cells_are_flown_around(make_world: MakeWorld) -> None:
    wall = [(3, y, 0) for y in range(6)]
    world = make_world((7, 7, 1), 10.0, blocked=wall)
    learner = last(world, 6, 0)
    assert not world.airspace.blocked[learner.measured_cells].any()
    assert reached_share(exhaustive_summary(None, world, TASK, learner.policy())) == 1.0


def test_a_prior_map_helps_from_the_first_flight_on_and_may_have_holes(make_world: MakeWorld) -> None:
    world = smooth_world(make_world, (10, 10, 1))
    greedy, optimal = (exhaustive_summary(None, world, TASK, p) for p in (GreedyPolicy(world), OptimalPolicy(world, TASK)))
    prior = world.signal.mean_db.astype(np.float64) - 15.0
    prior[:5] = np.nan
    scores = []
    for known in (prior, None):
        figures = [exhaustive_summary(None, world, TASK, last(world, 1, seed, FAST, known).policy()) for seed in range(3)]
        scores.append(np.mean([score(f, greedy, optimal) for f in figures]))
    assert scores[0] > 0.9
    assert scores[0] > scores[1] + 0.1


def test_a_truth_that_is_none_is_refused(make_world: MakeWorld) -> None:
    for world in (make_world((3, 3, 1), sinr_std_db=1.0), make_world((3, 3, 1), [-np.inf] + [3.0] * 8)):
        with pytest.raises(InputError, match="sinr_std_db 0"):
            last(world, 1, 0)


@pytest.mark.parametrize(
    "bad", [{"exploration": "luck"}, {"optimism": -1.0}, {"replan_every_steps": -1}, {"discount": 0.0}, {"discount": 1.5}]
)
def test_impossible_settings_are_refused(bad: dict) -> None:
    with pytest.raises(InputError, match=next(iter(bad))):
        FAST.changed(**bad)


def test_settings_are_not_changed_by_learning(make_world: MakeWorld) -> None:
    kernel = Kernel(std_db=3.0)
    learner = list(learn_map(smooth_world(make_world), TASK, FAST, 0, [4], None, kernel))[-1]
    assert learner.first_kernel == kernel == Kernel(std_db=3.0)
    assert learner.posterior.kernel != kernel


def test_it_needs_no_jax() -> None:
    code = "import sys, cellpilot.learn.algorithms.map_learner; sys.exit('jax' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
