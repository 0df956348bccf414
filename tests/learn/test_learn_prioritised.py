"""Prioritised replay: chances, importance weights, and what happens to the priority of a row."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.learn.prioritised import FAN, draw_in_proportion, importance_weights, renew_priorities
from cellpilot.learn.replay import Experience, Replay, add, init_replay
from cellpilot.task import Transition

draw = jax.jit(draw_in_proportion, static_argnums=3)
add_compiled = jax.jit(add)


def assert_frequencies(rows: np.ndarray, chance: np.ndarray) -> None:
    """Chi-square of the counts, over what can be drawn; nothing else may be."""
    counts = np.bincount(rows, minlength=len(chance))
    assert len(counts) == len(chance)
    assert not counts[chance == 0].any()
    expected = rows.size * chance[chance > 0]
    assert expected.min() > 5
    chi_square = ((counts[chance > 0] - expected) ** 2 / expected).sum()
    freedom = expected.size - 1
    assert abs(chi_square - freedom) < 5 * np.sqrt(2 * freedom) + 5


@pytest.mark.parametrize("size", [1, FAN, 30, 300])
def test_rows_are_drawn_in_proportion_to_their_priority(size: int) -> None:
    priority = np.zeros(300, np.float32)
    priority[:size] = np.random.default_rng(0).uniform(0.1, 3.0, size)
    rows = draw(jax.random.key(1), jnp.asarray(priority), jnp.int32(size), (400, 300))
    assert rows.shape == (400, 300)
    assert_frequencies(np.asarray(rows).ravel(), priority / priority.sum())


def test_a_large_memory_is_drawn_from_alike() -> None:
    """Over four levels: chances of stretches of rows, of which few have nearly everything, and of single rows."""
    size = 2 * FAN**3 + 5
    priority = np.zeros(3 * FAN**3, np.float32)
    priority[:size] = np.random.default_rng(1).exponential(1.0, size) * np.where(np.arange(size) < 1_000, 1.0, 1e-3)
    priority[size - 1] = 20.0
    rows = np.asarray(draw(jax.random.key(2), jnp.asarray(priority), jnp.int32(size), (40_000,)))
    chance = priority / priority.sum(dtype=np.float64)
    assert rows.max() == size - 1
    stretch = np.arange(len(priority)) // 200
    assert_frequencies(stretch[rows], np.bincount(stretch, chance))
    often = np.sort(np.argsort(chance)[-100:])
    assert_frequencies(np.searchsorted(often, rows[np.isin(rows, often)]), chance[often] / chance[often].sum())
    assert (draw(jax.random.key(3), jnp.asarray(priority), jnp.int32(size), rows.shape) != rows).any()


@pytest.mark.parametrize("exponent", [0.0, 0.4, 1.0])
def test_importance_weights_are_those_of_the_formula(exponent: float) -> None:
    priority = np.array([0.5, 2.0, 0.25, 4.0, 0.0, 0.0], np.float32)
    rows = np.array([[0, 1, 3], [2, 2, 0]])
    found = importance_weights(jnp.asarray(priority), jnp.asarray(rows), jnp.int32(4), jnp.float32(exponent))
    chance = priority / 6.75
    for batch, weights in zip(rows, found, strict=True):
        plain = [(1 / 4 / chance[row]) ** exponent for row in batch]
        np.testing.assert_allclose(weights, np.array(plain) / max(plain), rtol=1e-5)
    if exponent == 1.0:  # chance times weight is the same for all rows: the average is that of even draws
        np.testing.assert_allclose(np.ptp(np.asarray(found[0]) * chance[rows[0]]), 0.0, atol=1e-7)


def test_priorities_are_renewed_by_the_errors() -> None:
    """Signs do not matter, a row drawn twice keeps its greatest error, whatever it had before is gone."""
    rows, errors = jnp.array([[4, 1], [1, 2]]), jnp.array([[-3.0, -2.0], [0.5, 0.0]])
    found = renew_priorities(jnp.array([7.0, 9.0, 9.0, 7.0, 1.0]), rows, errors, 0.6)
    np.testing.assert_allclose(found, [7.0, 2.0**0.6, 1e-6**0.6, 7.0, 3.0**0.6], rtol=1e-4)


def add_rows(replay: Replay, n: int) -> Replay:
    i = jnp.arange(5)
    return add_compiled(
        replay, Experience(Transition(i, i, i, i.astype(jnp.float32), (i > 0).astype(jnp.uint8)), i), jnp.int32(n)
    )


def test_new_experiences_get_the_greatest_priority_and_overwritten_ones_lose_theirs() -> None:
    replay = add_rows(init_replay(10, prioritised=True), 4)
    np.testing.assert_array_equal(replay.priority, [1] * 4 + [0] * 6)
    assert replay.priority is not None
    priority = renew_priorities(replay.priority, jnp.array([0, 1, 2]), jnp.array([5.0, 0.3, 2.0]), 1.0)
    replay = add_rows(replace(replay, priority=priority), 3)
    np.testing.assert_allclose(replay.priority, [5, 0.3, 2, 1, 5, 5, 5, 0, 0, 0], rtol=1e-5)
    replay = add_rows(replay, 5)  # over the end of the ring: rows 7, 8, 9, 0, 1
    np.testing.assert_allclose(replay.priority, [5, 5, 2, 1, 5, 5, 5, 5, 5, 5], rtol=1e-5)
    # The greatest is that of what is stored now: a greater one is forgotten when its row has a new error.
    replay = add_rows(replace(replay, priority=jnp.array([0.5, 1, 7, 1, 1, 1, 1, 1, 1, 1])), 1)
    np.testing.assert_array_equal(replay.priority, [0.5, 1, 7, 1, 1, 1, 1, 1, 1, 1])
    replay = add_rows(replace(replay, priority=jnp.array([0.5, 1, 3, 1, 1, 1, 1, 1, 1, 1])), 1)
    np.testing.assert_array_equal(replay.priority, [0.5, 1, 3, 3, 1, 1, 1, 1, 1, 1])
