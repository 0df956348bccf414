"""Several seeds in one program: each is the training it would be alone, on one device and on two."""

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.errors import InputError
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.checkpoint import named_leaves
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import TrainingProgress, TrainingResult, train_many, train_one
from cellpilot.task import Task
from cellpilot.world import World

TASK = Task(rho_blocked=-0.5, max_steps=12)
SMALL = DDQNHER(
    episodes=16,
    batch_size=8,
    replay_capacity=900,
    replay_start=120,
    updates_per_episode=3,
    target_period=5,
    hidden_layers=2,
    hidden_units=8,
)
SEEDS = (3, 4, 8)


@pytest.fixture(scope="module")
def place(random_world: Callable[..., World]) -> Place:
    return Place(random_world(5, (4, 3, 1), 0.15, noise_std_db=2.0, sinr_std_db=1.0), TASK)


@pytest.fixture(scope="module")
def arena(place: Place) -> Arena:
    return make_arena(place.world)


@pytest.fixture(scope="module")
def alone(place: Place) -> list[TrainingResult]:
    return [train_one(SMALL, place, seed, chunk_rounds=5) for seed in SEEDS]


def assert_close(one: TrainingResult, other: TrainingResult) -> None:
    """Equal up to rounding: short enough that rounding has not yet been amplified into another action."""
    first, second = named_leaves(one.state), named_leaves(other.state)
    assert first.keys() == second.keys()
    for name in first:
        np.testing.assert_allclose(first[name], second[name], atol=2e-5, err_msg=name)
    for name, column in one.history.items():
        np.testing.assert_allclose(column, other.history[name], atol=1e-4, err_msg=name)


def test_each_seed_is_the_training_it_would_be_alone(place: Place, alone: list[TrainingResult]) -> None:
    together = train_many(SMALL, place, SEEDS, chunk_rounds=5)
    for one, other in zip(alone, together, strict=True):
        assert other.finished
        assert_close(one, other)
    returns = {result.history["episode_return"].tobytes() for result in together}
    weights = {np.asarray(result.state.online.network.layers[0].weight).tobytes() for result in together}
    assert len(returns) == len(weights) == len(SEEDS)


def test_seeds_that_are_not_equally_far_catch_up(tmp_path: Path, place: Place, alone: list[TrainingResult]) -> None:
    files = [tmp_path / f"{seed}.safetensors" for seed in SEEDS]
    left = iter([False, True])
    first = train_one(SMALL, place, SEEDS[1], checkpoint=files[1], chunk_rounds=5, interrupted=lambda: next(left))
    assert len(first.history["reached"]) == 5
    left = iter([False] * 2 + [True])
    parts = train_many(SMALL, place, SEEDS, checkpoints=files, chunk_rounds=5, interrupted=lambda: next(left))
    assert [len(part.history["reached"]) for part in parts] == [10, 10, 10]
    assert not any(part.finished for part in parts)
    seen: list[TrainingProgress] = []
    results = train_many(SMALL, place, SEEDS, checkpoints=files, chunk_rounds=5, progress=seen.append)
    assert [(p.done, p.rounds) for p in seen] == [(10, 16), (15, 16), (16, 16)]
    for one, other in zip(alone, results, strict=True):
        assert_close(one, other)


def test_a_resumed_training_of_many_equals_an_uninterrupted_one_bit_for_bit(tmp_path: Path, place: Place) -> None:
    whole = train_many(SMALL, place, SEEDS, chunk_rounds=5)
    files = [tmp_path / f"{seed}.safetensors" for seed in SEEDS]
    left = iter([False, True])
    train_many(SMALL, place, SEEDS, checkpoints=files, chunk_rounds=4, interrupted=lambda: next(left))
    resumed = train_many(SMALL, place, SEEDS, checkpoints=files, chunk_rounds=3, checkpoint_every_s=0.0)
    for one, other in zip(whole, resumed, strict=True):
        for name, leaf in named_leaves(one.state).items():
            assert np.asarray(leaf).tobytes() == np.asarray(named_leaves(other.state)[name]).tobytes(), name
        for name, column in one.history.items():
            np.testing.assert_array_equal(column, other.history[name])


def test_a_checkpoint_of_another_seed_is_refused(tmp_path: Path, place: Place) -> None:
    files = [tmp_path / "a.safetensors", tmp_path / "b.safetensors"]
    short = SMALL.changed(episodes=2)
    train_many(short, place, (1, 2), checkpoints=files)
    with pytest.raises(InputError, match=r"a\.safetensors.*seed"):
        train_many(short, place, (2, 1), checkpoints=files)


TWO_DEVICES = """
import jax, numpy as np
from cellpilot.airspace import Airspace
from cellpilot.signal import Signal
from test_learn_seeds import SEEDS, SMALL, TASK, assert_close
from cellpilot.grid import Grid
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_one, train_many
from cellpilot.world import World

assert jax.local_device_count() == 2
grid = Grid((0.0, 20.0, 40.0), (0.0, 20.0, 40.0), (30.0,))
rng = np.random.default_rng(0)
world = World(Airspace.of_blocked(grid, np.arange(9) == 4), Signal(rng.normal(3, 6, 9).astype(np.float32), 2.0))
place = Place(world, TASK)
for n in (2, 3):  # three seeds do not divide by two devices
    together = train_many(SMALL, place, SEEDS[:n], chunk_rounds=5)
    for seed, result in zip(SEEDS, together):
        assert_close(train_one(SMALL, place, seed, chunk_rounds=5), result)
print("equal")
"""


def test_seeds_are_spread_over_two_devices() -> None:
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    command = [sys.executable, "-c", TWO_DEVICES]
    folder = Path(__file__).parent
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=300, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "equal"
