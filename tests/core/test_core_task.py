import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.airspace import MOVED, STOPPED
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.task import Task, Transition, default_max_steps
from cellpilot.world import World

ODD = Task(rho_goal=7.0, rho_sinr=-1.5, rho_step=-0.25, rho_blocked=-3.0, threshold_db=2.0)


def test_outcome_by_hand() -> None:
    cases = [  # next cell, sinr, blocked, goal -> reward, terminated
        (5, 4.0, False, 9, -0.25, False),
        (5, 1.0, False, 9, -1.75, False),
        (5, 2.0, False, 9, -0.25, False),  # at the threshold is not below it
        (5, 4.0, True, 9, -3.25, False),
        (5, 1.0, True, 9, -4.75, False),
        (5, 4.0, False, 5, 6.75, True),
        (5, 1.0, False, 5, 5.25, True),
        (5, -math.inf, False, 9, -1.75, False),
    ]
    for next_cell, sinr_db, blocked, goal, reward, terminated in cases:
        event = STOPPED if blocked else MOVED
        found = ODD.outcome(Transition(4, 0, np.int32(next_cell), np.float32(sinr_db), np.uint8(event)), np.int32(goal))
        assert found == (pytest.approx(reward), terminated, terminated)


def test_the_rewards_of_the_thesis() -> None:
    task = Task()
    assert (task.rho_goal, task.rho_sinr, task.rho_step, task.rho_blocked) == (10.0, -1.0, -0.1, 0.0)
    assert (task.threshold_db, task.discount, task.max_steps) == (3.0, 0.995, 400)


@settings(max_examples=12)
@given(
    seed=st.integers(0, 2**31),
    rewards=st.tuples(*[st.floats(0.1, 10.0), *[st.floats(-3.0, -0.1)] * 3]),
    spreads=st.sampled_from([(2.0, 0.0), (0.0, 3.0), (1.5, 2.5), (0.0, 0.0)]),
)
def test_expected_outcome_is_the_mean_outcome(
    random_world: Callable[..., World],
    seed: int,
    rewards: tuple[float, float, float, float],
    spreads: tuple[float, float],
) -> None:
    """Holds the environment's reward and the optimum's together: a term in one and not in the other fails here."""
    rho_goal, rho_sinr, rho_step, rho_blocked = rewards
    task = Task(rho_goal, rho_sinr, rho_step, rho_blocked, threshold_db=2.5)
    world = random_world(seed, (4, 3, 1), 0.35, *spreads)
    rng = np.random.default_rng(seed)
    n = 20_000
    cells = np.flatnonzero(~world.airspace.blocked)
    goal = int(rng.choice(cells))
    cell, action = (a.ravel() for a in np.meshgrid(cells, np.arange(4), indexing="ij"))
    next_cell = world.airspace.next_cell[cell, action]
    measured = (
        world.signal.mean_db[next_cell]
        + world.signal.std_db[next_cell] * rng.standard_normal((n, len(cell)))
        + world.signal.noise_std_db * rng.standard_normal((n, len(cell)))
    )
    transition = Transition(cell, action, next_cell, measured, world.airspace.event[cell, action])
    reward, reached, terminated = task.outcome(transition, goal)
    expected, expected_reached, expected_terminated = task.expected_outcome(world, cell, action, goal)
    np.testing.assert_array_equal(terminated, expected_terminated)
    np.testing.assert_array_equal(reached, expected_reached)
    np.testing.assert_allclose(reward.mean(0), expected, atol=abs(rho_sinr) * 5 * 0.5 / math.sqrt(n) + 1e-9)
    given = task.expected_outcome(world, cell, action, goal, world.outage_probability(2.5)).reward
    np.testing.assert_array_equal(given, expected)


def test_expected_outcome_charges_for_a_blocked_move(make_world: Callable[..., World]) -> None:
    world = make_world((3, 1, 1), [1.0, 9.0, math.nan], blocked=[(2, 0, 0)])
    reward, *_ = ODD.expected_outcome(world, 1, 2, 0)  # east, into the blocked cell
    assert reward == pytest.approx(-0.25 - 3.0)
    reward, *_ = ODD.expected_outcome(world, 1, 0, 0)  # north, over the border: no charge
    assert reward == pytest.approx(-0.25)
    reward, _, terminated = ODD.expected_outcome(world, 1, 3, 0)
    assert reward == pytest.approx(-0.25 + 7.0 - 1.5)
    assert terminated


@pytest.mark.parametrize(("sides", "cap"), [((20, 20, 1), 400), ((20, 20, 5), 450), ((20, 1, 1), 200)])
def test_default_cap(sides: tuple[int, int, int], cap: int) -> None:
    assert default_max_steps(Grid(*(tuple(float(i) for i in range(n)) for n in sides))) == cap


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"discount": 0.0}, "discount"),
        ({"discount": 1.01}, "discount"),
        ({"discount": math.nan}, "discount"),
        ({"max_steps": 0}, "max_steps"),
    ],
)
def test_tasks_that_cannot_be_flown(settings: dict[str, float], message: str) -> None:
    with pytest.raises(InputError, match=message):
        Task(**settings)  # type: ignore[arg-type]
