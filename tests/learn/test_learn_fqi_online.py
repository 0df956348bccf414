"""FQI-HER goes on learning elsewhere: what it remembers, and that it learns from its own flights alone."""

from collections.abc import Callable
from dataclasses import replace

import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.learn.algorithms.fqi_her_online import OnlineSettings, learn_online, remembered
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner import start_and_goal
from cellpilot.learn.learner import Place
from cellpilot.learn.penalty import measure, no_measurements, penalty_model
from cellpilot.learn.trainer import TrainingResult, train_one
from cellpilot.task import Task
from cellpilot.world import World

MakeWorld = Callable[..., World]
TASK = Task(max_steps=100)
SMALL = FQIHER(
    rounds=30,
    flights=16,
    steps_per_round=12,
    updates_per_round=10,
    batch_size=256,
    goals_per_round=25,
    hidden_units=32,
    look_ahead=1,
)
FEW = OnlineSettings(rounds_per_flight=2)


@pytest.fixture(scope="module")
def trained(make_world: MakeWorld) -> TrainingResult:
    """Trained where the west is bad."""
    return train_one(SMALL, Place(make_world((6, 6, 1), np.where(np.arange(36) % 6 < 3, -5.0, 10.0)), TASK), 0)


def actions(trained: TrainingResult, world: World, seed: int = 0, flights: int = 3) -> list[bytes]:
    """The actions of every pair at the checkpoints 0 and `flights`."""
    found = learn_online(trained.state, SMALL, world, TASK, seed, [0, flights], FEW)  # type: ignore[arg-type]
    return [policy.action_probabilities(np.arange(36)).tobytes() for policy in found]


def test_what_was_measured_is_remembered_as_two_measurements_of_equal_mean_and_spread() -> None:
    rng = np.random.default_rng(0)
    memory = no_measurements(4, 8)
    for sinr_db in rng.normal(5.0, 2.0, (30, 2)).astype(np.float32):
        memory = measure(memory, jnp.array([0, 2]), jnp.asarray(sinr_db))
    short = remembered(memory)
    assert short.count.tolist() == [2, 0, 2, 0]
    for cell in (0, 2):
        mean_db = [float((m.first_db + m.sum_db / m.count)[cell]) for m in (memory, short)]
        spread_db2 = [float((m.sum_squared_db / m.count - (m.sum_db / m.count) ** 2)[cell]) for m in (memory, short)]
        assert mean_db[1] == pytest.approx(mean_db[0], abs=1e-4)
        assert spread_db2[1] == pytest.approx(spread_db2[0], abs=1e-3)
        assert np.sort(short.last_db[cell, :2]) == pytest.approx(mean_db[0] + np.array([-1, 1]) * spread_db2[0] ** 0.5, abs=1e-3)
    # A few new measurements now count.
    for _ in range(6):
        short = measure(short, jnp.array([0, 0]), jnp.array([-30.0, -30.0]))
    assert penalty_model(short, 3.0)[0] > 0.8


def test_unvisited_cells_of_the_truth_change_nothing_and_seeds_differ(trained: TrainingResult, make_world: MakeWorld) -> None:
    world = make_world((6, 6, 1), 10.0)
    before, after = actions(trained, world)
    assert before != after
    assert actions(trained, world) == [before, after]
    assert actions(trained, world, seed=1)[0] == before
    assert actions(trained, world, seed=1)[1] != after
    changes = []
    for cell in range(36):
        other_db = world.signal.mean_db.copy()
        other_db[cell] = -20.0
        changes.append(
            actions(trained, replace(world, signal=replace(world.signal, mean_db=other_db)), flights=1)
            != actions(trained, world, flights=1)
        )
    start, goal = start_and_goal(world, 0, 0)
    steps = int(world.grid.manhattan(start, goal))
    assert steps <= sum(changes) < 36  # no more cells than one flight visits, among them the goal
    assert changes[goal]
