from collections import deque
from collections.abc import Iterable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.learn.replay import Experience, Replay, add, draw_rows, init_replay
from cellpilot.task import Transition

ROWS = 6
add_compiled = jax.jit(add)


def block_of(first: int, rows: int = ROWS) -> Experience:
    """Rows that carry their own number in every field."""
    i = jnp.arange(first, first + rows)
    return Experience(Transition(i, i % 4, i + 1, i.astype(jnp.float32) / 2, (i % 3).astype(jnp.uint8)), i + 7)


def numbers(experiences: Experience) -> np.ndarray:
    """The numbers of the rows, after checking that all fields of a row belong together."""
    transition, goal, _ = jax.tree.map(np.asarray, experiences)
    i = transition.cell
    np.testing.assert_array_equal(transition.action, i % 4)
    np.testing.assert_array_equal(transition.next_cell, i + 1)
    np.testing.assert_array_equal(transition.sinr_db, i / 2)
    np.testing.assert_array_equal(transition.event, i % 3)
    np.testing.assert_array_equal(goal, i + 7)
    return i


def filled(capacity: int, blocks: Iterable[int]) -> tuple[Replay, deque[int]]:
    """The memory and a plain queue after adding the first n rows of block upon block."""
    replay, queue, next_row = init_replay(capacity), deque[int](maxlen=capacity), 0
    for n in blocks:
        replay = add_compiled(replay, block_of(next_row), jnp.int32(n))
        queue.extend(range(next_row, next_row + n))
        next_row += n
    return replay, queue


@settings(max_examples=30)
@given(st.sampled_from([6, 7, 13]), st.lists(st.integers(0, ROWS), max_size=12))
def test_the_memory_is_a_bounded_queue(capacity: int, blocks: list[int]) -> None:
    replay, queue = filled(capacity, blocks)
    assert replay.capacity == capacity
    assert int(replay.size) == len(queue)
    assert int(replay.head) == sum(blocks) % capacity
    stored = jax.tree.map(lambda ring: ring[: len(queue)], replay.experiences)
    assert sorted(numbers(stored).tolist()) == sorted(queue)


@pytest.mark.parametrize("blocks", [[3], [6, 4], [6, 6, 6, 5]])
def test_samples_are_uniform_over_what_is_stored(blocks: list[int]) -> None:
    replay, queue = filled(13, blocks)
    n = 400 * len(queue)
    row = draw_rows(jax.random.key(0), replay, (n // 4, 4)).ravel()
    drawn = numbers(jax.tree.map(lambda ring: ring[row], replay.experiences))
    counts = np.array([np.count_nonzero(drawn == i) for i in queue])
    assert counts.sum() == n
    chi_square = ((counts - 400) ** 2 / 400).sum()
    freedom = len(queue) - 1
    assert chi_square < freedom + 5 * np.sqrt(2 * freedom)


def test_samples_have_the_shape_asked_for() -> None:
    replay, _ = filled(13, [5])
    assert draw_rows(jax.random.key(0), replay, (3, 2)).shape == (3, 2)


def test_a_flight_that_outgrows_the_memory_is_refused() -> None:
    with pytest.raises(InputError, match="replay capacity 5"):
        add(init_replay(5), block_of(0), jnp.int32(2))
