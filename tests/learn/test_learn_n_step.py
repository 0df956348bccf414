"""Returns of several steps against a loop over the flight itself, for its own goal and for those of hindsight."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.airspace import STOPPED
from cellpilot.envs.flight import Flight
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHERVariants
from cellpilot.learn.algorithms.ddqn_her_variants import populate_memory
from cellpilot.learn.n_step import outcome_of_steps
from cellpilot.learn.replay import Replay, init_replay
from cellpilot.task import Task, Transition

PADDED = 9
TASK = Task(rho_blocked=-0.5, threshold_db=0.0, discount=0.9, max_steps=PADDED)
FLIGHTS = [  # cells one after the other, and the goal: the next flight starts where the last one ended
    ([10, 11, 12, 11, 13, 13, 14], 14),
    ([14, 15, 16, 15, 11, 12], 30),  # truncated
    ([12, 13], 13),
    ([13, 12, 11, 10, 10, 11, 12, 13, 14, 15], 40),  # truncated by the cap
    ([15, 14, 13, 12], 12),
]
COPIES = 3
populate = jax.jit(populate_memory, static_argnums=1)
look = jax.jit(outcome_of_steps, static_argnums=(2, 3, 4))


def flight_of(cells: list[int], goal: int) -> Flight:
    """The padding holds cells that must never be looked at: among them the goal."""
    n = len(cells) - 1
    pad = lambda values, filler: jnp.asarray([*values, *[filler] * (PADDED - n)])
    sinr_db = pad([(-1.0) ** cell * t for t, cell in enumerate(cells[1:])], -99.0)
    event = pad([STOPPED * (a == b) for a, b in pairwise(cells)], STOPPED).astype(jnp.uint8)
    transitions = Transition(pad(cells[:-1], goal), jnp.arange(PADDED) % 4, pad(cells[1:], goal), sinr_db, event)
    reached = jnp.asarray(cells[-1] == goal)
    return Flight(transitions, jnp.int32(goal), jnp.int32(n), reached, reached)


def stored(n_steps: int, strategy: str, capacity: int) -> tuple[Replay, list[tuple[int, int]]]:
    """The memory after all flights, and of each of its rows the flight and the step it came from."""
    settings = DDQNHERVariants().changed(n_steps=n_steps, hindsight_ratio=COPIES - 1, hindsight_strategy=strategy)
    replay, origin = init_replay(capacity, with_steps_left=n_steps > 1), [(-1, -1)] * capacity
    head = 0
    for number, (cells, goal) in enumerate(FLIGHTS):
        replay = populate(jax.random.key(number), settings, replay, flight_of(cells, goal))
        for step in range(len(cells) - 1):
            for _ in range(COPIES):
                origin[head % capacity] = (number, step)
                head += 1
    assert int(replay.head) == head % capacity
    return replay, origin[: int(replay.size)]


def plain_outcome(flight: Flight, step: int, goal: int, n_steps: int) -> tuple[float, bool, int, float, int]:
    total, factor, used = 0.0, 1.0, 0
    facts = [np.asarray(field).tolist() for field in flight.transitions]
    while used < n_steps and step + used < int(flight.n_steps):
        _, _, next_cell, sinr_db, event = (field[step + used] for field in facts)
        reward = -0.1 + (10.0 if next_cell == goal else 0.0) - (1.0 if sinr_db < 0 else 0.0) - (0.5 if event == STOPPED else 0.0)
        total, factor, used = total + factor * reward, factor * 0.9, used + 1
        if next_cell == goal:
            return total, True, next_cell, factor, used
    return total, False, next_cell, factor, used


@pytest.mark.parametrize(
    ("n_steps", "strategy", "capacity"),
    [(1, "future", 200), (3, "future", 200), (4, "episode", 200), (2, "episode", 50), (3, "future", 50), (20, "final", 50)],
)
def test_the_outcome_is_that_of_the_flight(n_steps: int, strategy: str, capacity: int) -> None:
    """In the memory of 50 the first flight is overwritten, the second in part."""
    replay, origin = stored(n_steps, strategy, capacity)
    flights = [flight_of(cells, goal) for cells, goal in FLIGHTS]
    goals = np.asarray(replay.experiences.goal[: len(origin)])
    expected = [plain_outcome(flights[f], t, int(goals[row]), n_steps) for row, (f, t) in enumerate(origin)]
    rows = jnp.arange(len(origin)).reshape(2, -1)
    reward, terminated, next_cell, discount = look(replay, rows, TASK, n_steps, COPIES)
    total, ended, last, factor, used = (np.array(column).reshape(rows.shape) for column in zip(*expected, strict=True))
    np.testing.assert_allclose(reward, total, atol=1e-5)
    np.testing.assert_array_equal(terminated, ended)
    np.testing.assert_array_equal(next_cell, last)
    if n_steps == 1:
        assert discount is None
    else:
        np.testing.assert_allclose(discount, factor, rtol=1e-5)
    if n_steps in (3, 4):  # what the flights were made for
        relabelled = goals.reshape(rows.shape) != np.array([FLIGHTS[f][1] for f, _ in origin]).reshape(rows.shape)
        assert (relabelled & ended & (used == 2)).any()  # a hindsight goal is entered on the way
        assert (~ended & (used < n_steps)).any()  # a truncated flight ends first
        assert (~ended & (used == n_steps)).any()


def test_one_step_keeps_nothing_more() -> None:
    replay, _ = stored(1, "future", 200)
    assert replay.experiences.steps_left is None
