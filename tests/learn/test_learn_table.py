"""A second learner plugs into the trainer by one line of the table: rounds are counted, saved and resumed for it too."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import partial
from pathlib import Path
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.experiment import make_learner
from cellpilot.learn.algorithms.base import AlgorithmSettings
from cellpilot.learn.algorithms.table import ALGORITHMS, Algorithm, TrainState
from cellpilot.learn.trainer import TrainingProgress, train
from cellpilot.policies import PolicyParameters
from cellpilot.scenario import LEARNERS
from cellpilot.task import Task
from cellpilot.world import World


@dataclass(frozen=True)
class Guessing:
    """Settings of an algorithm that adds up random numbers."""

    algorithm: ClassVar[str] = "guessing"
    counts: ClassVar[str] = "rounds"
    chunk_rounds: ClassVar[int] = 4
    updates: ClassVar[int] = 0
    explores_by: ClassVar[str] = "nothing"
    rounds: int = 10

    def check_fits(self, task: Task) -> None:
        """Everything fits."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GuessingState:
    total: jax.Array
    rounds_done: jax.Array
    env_steps: jax.Array


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class GuessingRows:
    episode_return: jax.Array
    reached: jax.Array
    q_error: jax.Array


def empty_rows(length: int) -> GuessingRows:
    return GuessingRows(jnp.zeros(length), jnp.zeros(length), jnp.zeros(length, jnp.int32))


@partial(jax.jit, static_argnames=("settings", "task", "length"), donate_argnames="state")
def train_chunk(
    state: GuessingState, arena: Arena, seed: jax.Array, n: jax.Array, *, settings: Guessing, task: Task, length: int
) -> tuple[GuessingState, GuessingRows]:
    def body(i: jax.Array, carry: tuple[GuessingState, GuessingRows]) -> tuple[GuessingState, GuessingRows]:
        state, rows = carry
        draw = jax.random.uniform(jax.random.fold_in(jax.random.key(seed), state.rounds_done))
        state = GuessingState(state.total + draw, state.rounds_done + 1, state.env_steps + 7)
        return state, jax.tree.map(lambda rows, value: rows.at[i].set(value), rows, GuessingRows(draw, draw, i * 0 + 5))

    return jax.lax.fori_loop(0, n, body, (state, empty_rows(length)))


GUESSING = Algorithm(
    initial_state=lambda settings, arena, seed: GuessingState(jnp.float32(seed), jnp.int32(0), jnp.int32(0)),
    fill_replay=None,
    train_chunk=train_chunk,
    empty_rows=empty_rows,
    exploration_at=lambda settings, n: n * 0.0,
    learned=lambda state: state.total,
    policy_parameters=lambda state, settings, sides, about: PolicyParameters({"total": np.asarray(state.total)}, "none", sides),
)


def test_another_algorithm_trains_in_rounds_and_resumes(
    tmp_path: Path, make_world: Callable[..., World], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(ALGORITHMS, "guessing", GUESSING)
    arena, seen = make_arena(make_world((3, 2, 1))), list[TrainingProgress]()
    whole = train(Guessing(), Task(), arena, seed=2, progress=seen.append)
    assert [(p.done, p.rounds) for p in seen] == [(4, 10), (8, 10), (10, 10)]
    assert whole.finished
    assert whole.env_steps == 70
    assert {name: len(column) for name, column in whole.history.items()} == dict.fromkeys(
        ("episode_return", "reached", "q_error", "exploration"), 10
    )
    assert whole.history["q_error"].dtype == np.int32
    assert float(whole.state.total) == pytest.approx(2 + whole.history["episode_return"].sum(), rel=1e-5)
    assert whole.policy_parameters((3, 2, 1), {}).tensors["total"] == float(whole.state.total)

    checkpoint, left = tmp_path / "state.safetensors", iter([False, True])
    part = train(Guessing(), Task(), arena, 2, checkpoint=checkpoint, interrupted=lambda: next(left))
    assert not part.finished
    resumed = train(Guessing(), Task(), arena, 2, checkpoint=checkpoint, chunk_rounds=3)
    for name, column in whole.history.items():
        np.testing.assert_array_equal(resumed.history[name], column)
    assert float(resumed.state.total) == float(whole.state.total)


@pytest.mark.parametrize("name", ALGORITHMS)
def test_every_algorithm_has_settings_a_state_and_rows_as_the_trainer_reads_them(
    make_world: Callable[..., World], name: str
) -> None:
    settings = make_learner(LEARNERS[name]())
    assert isinstance(settings, AlgorithmSettings)
    assert settings.algorithm == name
    state = ALGORITHMS[name].initial_state(settings, make_arena(make_world((3, 2, 1))), 0)
    assert isinstance(state, TrainState)
    assert int(state.rounds_done) == 0
    assert {"episode_return", "reached"} <= {field.name for field in fields(ALGORITHMS[name].empty_rows(1))}
    assert LEARNERS.keys() == ALGORITHMS.keys()
