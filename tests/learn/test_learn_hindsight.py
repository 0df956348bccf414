import jax
import jax.numpy as jnp
import numpy as np
import pytest

from cellpilot.envs.flight import Flight
from cellpilot.learn.algorithms import ddqn_her_variants
from cellpilot.learn.algorithms.ddqn_her import populate_memory
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.hindsight import hindsight_goals
from cellpilot.learn.replay import Experience, init_replay
from cellpilot.task import Task, Transition

PADDED, T = 9, 6
ENTERED = (11, 12, 11, 13, 13, 14)  # cells entered by steps 0..5: one visited twice, one waited in


def flight_of(terminated: bool = True) -> Flight:
    """Six real steps out of nine rows; the padding holds cells that must never be stored."""
    entered = jnp.asarray([*ENTERED, 99, 98, 97])
    cell = jnp.concatenate([jnp.asarray([10]), entered[:-1]])
    transitions = Transition(cell, jnp.arange(PADDED) % 4, entered, jnp.arange(PADDED) - 1.5, jnp.zeros(PADDED, jnp.uint8))
    return Flight(
        transitions, jnp.int32(14 if terminated else 30), jnp.int32(T), jnp.asarray(terminated), jnp.asarray(terminated)
    )


@pytest.mark.parametrize("strategy", ["future", "final", "episode"])
def test_goals_are_drawn_uniformly_from_where_they_may_come_from(strategy: str) -> None:
    k = 12_000
    goals = np.asarray(hindsight_goals(jax.random.key(0), flight_of(), k, strategy))
    assert goals.shape == (PADDED, k)
    for t in range(T):
        source = {"future": ENTERED[t:], "final": ENTERED[-1:], "episode": ENTERED}[strategy]
        assert set(goals[t].tolist()) == set(source)
        for cell in set(source):
            share = source.count(cell) / len(source)
            assert np.mean(goals[t] == cell) == pytest.approx(share, abs=5 * np.sqrt(share * (1 - share) / k) + 1e-9)


def test_goals_of_one_step_are_independent_draws() -> None:
    goals = np.asarray(hindsight_goals(jax.random.key(1), flight_of(), 4_000, "episode"))
    assert abs(np.corrcoef(goals[0] == 11, goals[1] == 11)[0, 1]) < 0.08
    other = np.asarray(hindsight_goals(jax.random.key(2), flight_of(), 4_000, "episode"))
    assert (goals != other).any()


@pytest.mark.parametrize("k", [0, 1, 3])
@pytest.mark.parametrize("terminated", [True, False])
def test_every_step_is_stored_once_for_its_own_goal_and_k_times_in_hindsight(k: int, terminated: bool) -> None:
    flight = flight_of(terminated)
    settings, store = DDQNHER().changed(hindsight_ratio=max(k, 1)), populate_memory
    if k == 0:
        settings, store = DDQNHERVariants(hindsight=False), ddqn_her_variants.populate_memory
    replay = store(jax.random.key(3), settings, init_replay(100), flight)
    assert int(replay.size) == T * (1 + k)
    stored: Experience = jax.tree.map(lambda ring: np.asarray(ring[: T * (1 + k)]), replay.experiences)
    facts = list(zip(*(field.tolist() for field in stored.transition), strict=True))
    expected = list(zip(*(np.asarray(field).tolist() for field in flight.transitions), strict=True))[:T]
    for t, fact in enumerate(expected):
        rows = [i for i, found in enumerate(facts) if found == fact]
        assert len(rows) == 1 + k
        goals = stored.goal[rows].tolist()
        assert goals.count(int(flight.goal)) >= 1
        goals.remove(int(flight.goal))
        assert set(goals) <= set(ENTERED[t:])


def test_reward_and_termination_follow_the_goal_that_was_written() -> None:
    """Relabelling the reward without the terminal flag is the best-known error of hindsight replay."""
    replay = populate_memory(jax.random.key(4), DDQNHER().changed(hindsight_ratio=8), init_replay(1000), flight_of(False))
    stored: Experience = jax.tree.map(lambda ring: np.asarray(ring[: int(replay.size)]), replay.experiences)
    task = Task(threshold_db=0.0)
    reward, _, terminated = task.outcome(stored.transition, stored.goal)
    at_goal = np.array([n == g for n, g in zip(stored.transition.next_cell.tolist(), stored.goal.tolist(), strict=True)])
    np.testing.assert_array_equal(terminated, at_goal)
    low = stored.transition.sinr_db < 0
    np.testing.assert_allclose(reward, -0.1 + 10.0 * at_goal - 1.0 * low, atol=1e-6)
    assert at_goal.any()
    assert not at_goal[stored.goal == 30].any()
    last = stored.transition.sinr_db == T - 1 - 1.5
    assert at_goal[last & (stored.goal != 30)].all()  # the step that ends the flight is stored, and reaches what it reached
