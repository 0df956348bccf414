import math
from collections.abc import Callable
from statistics import NormalDist

import numpy as np
import pytest
import xarray as xr
from hypothesis import given, settings
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.world import World

SIDES = st.sampled_from([(5, 4, 1), (3, 3, 3), (6, 2, 1), (2, 3, 4), (7, 1, 1)])


@given(SIDES, st.integers(0, 2**31), st.sampled_from([0.0, 0.3, 0.6]))
def test_parts_and_free_cells_against_a_flood_fill(
    random_world: Callable[..., World], plain: Callable, sides: tuple[int, int, int], seed: int, share: float
) -> None:
    world = random_world(seed, sides, share)
    reference = plain(world)
    cell = {position: i for i, position in enumerate(reference.positions)}
    parts = [frozenset(cell[p] for p in part) for part in reference.parts()]
    found = {
        frozenset(np.flatnonzero(world.airspace.part == label).tolist()) for label in set(world.airspace.part.tolist()) - {-1}
    }
    assert found == set(parts)
    assert (world.airspace.part[world.airspace.blocked] == -1).all()
    assert sorted(world.airspace.free_cells.tolist()) == sorted(c for part in parts if len(part) > 1 for c in part)


@given(SIDES, st.integers(0, 2**31), st.sampled_from([0.0, 0.25, 0.5]))
def test_shortest_steps_against_breadth_first_search(
    random_world: Callable[..., World], plain: Callable, sides: tuple[int, int, int], seed: int, share: float
) -> None:
    world = random_world(seed, sides, share)
    reference = plain(world)
    goals = world.airspace.free_cells[:: max(1, len(world.airspace.free_cells) // 3)]
    steps = world.airspace.shortest_steps(goals)
    assert steps.shape == (world.grid.n_cells, len(goals))
    for column, goal in enumerate(goals):
        distances = reference.distances(reference.positions[goal])
        for here, position in enumerate(reference.positions):
            if position not in reference.blocked:
                assert steps[here, column] == distances.get(position, math.inf)


def test_low_probability_by_hand(make_world: Callable[..., World]) -> None:
    sinr = [5.0, 1.0, 3.0, -math.inf, 8.0, math.nan]
    blocked = [(5, 0, 0)]
    certain = make_world((6, 1, 1), sinr, blocked).signal.outage_probability(3.0)
    np.testing.assert_array_equal(certain, [0.0, 1.0, 0.0, 1.0, 0.0, math.nan])  # at the threshold is not below it

    noisy = make_world((6, 1, 1), sinr, blocked, noise_std_db=2.0).signal.outage_probability(3.0)
    below = NormalDist().cdf
    np.testing.assert_allclose(noisy, [below(-1.0), below(1.0), 0.5, 1.0, below(-2.5), math.nan], rtol=1e-12)

    both = make_world((6, 1, 1), sinr, blocked, noise_std_db=3.0, sinr_std_db=4.0).signal.outage_probability(3.0)
    np.testing.assert_allclose(both, [below(-0.4), below(0.4), 0.5, 1.0, below(-1.0), math.nan], rtol=1e-12)

    one_known = make_world((6, 1, 1), sinr, blocked, sinr_std_db=[4.0, 0.0, 1.0, 0.0, 0.0, 0.0]).signal.outage_probability(3.0)
    np.testing.assert_allclose(one_known, [below(-0.5), 1.0, 0.5, 1.0, 0.0, math.nan], rtol=1e-12)


def test_low_probability_is_the_frequency_of_low_measurements(make_world: Callable[..., World]) -> None:
    world = make_world((3, 1, 1), [1.0, 3.5, 6.0], noise_std_db=1.5, sinr_std_db=[0.0, 2.0, 1.0])
    rng = np.random.default_rng(0)
    n = 200_000
    measured = (
        world.signal.mean_db
        + world.signal.std_db * rng.standard_normal((n, 3))
        + world.signal.noise_std_db * rng.standard_normal((n, 3))
    )
    np.testing.assert_allclose((measured < 3.0).mean(0), world.signal.outage_probability(3.0), atol=0.006)


@pytest.mark.parametrize("noise", [-0.1, math.nan, math.inf])
def test_noise_that_is_no_standard_deviation(make_world: Callable[..., World], noise: float) -> None:
    with pytest.raises(InputError, match="noise_std_db"):
        make_world((3, 3, 1), noise_std_db=noise)


def test_a_free_cell_needs_a_value(make_world: Callable[..., World]) -> None:
    with pytest.raises(InputError, match="no SINR"):
        make_world((3, 1, 1), [1.0, math.nan, 2.0])
    make_world((3, 1, 1), [1.0, 2.0, math.nan], blocked=[(2, 0, 0)])


def test_nothing_connected(make_world: Callable[..., World]) -> None:
    checkerboard = [(x, y, 0) for x in range(4) for y in range(4) if (x + y) % 2]
    cases = [((3, 1, 1), [(1, 0, 0)]), ((2, 1, 1), [(0, 0, 0), (1, 0, 0)]), ((4, 4, 1), checkerboard)]
    for sides, blocked in cases:
        with pytest.raises(InputError, match="no connected pair"):
            make_world(sides, blocked=blocked).airspace.start_goal_cells()


@pytest.fixture
def two_parts(make_world: Callable[..., World]) -> World:
    """Columns 0-1 and 3-4 of a 5 x 2 grid, and a lonely cell at (6, 0): column 2 and 5 and (6, 1) are blocked."""
    return make_world((7, 2, 1), blocked=[(2, 0, 0), (2, 1, 0), (5, 0, 0), (5, 1, 0), (6, 1, 0)])


def test_start_and_goal_errors_name_the_problem(two_parts: World) -> None:
    cases = [
        ((0, 0, 0), (0, 0, 0), "both"),
        ((2, 0, 0), None, "start .* blocked"),
        (None, (2, 1, 0), "goal .* blocked"),
        ((6, 0, 0), None, "start .* cut off"),
        ((0, 0, 0), (3, 0, 0), "no route"),
        ((9, 0, 0), None, "start .* not on the grid"),
        (None, (0, 0, 1), "goal .* not on the grid"),
    ]
    for start, goal, message in cases:
        with pytest.raises(InputError, match=message):
            two_parts.airspace.start_goal_cells(start, goal)


def test_start_and_goal_cells(two_parts: World) -> None:
    free = [0, 1, 3, 4, 7, 8, 10, 11]
    starts, goals = two_parts.airspace.start_goal_cells()
    assert (starts.tolist(), goals.tolist()) == (free, free)
    starts, goals = two_parts.airspace.start_goal_cells((4, 1, 0))
    assert (starts.tolist(), goals.tolist()) == ([11], free)
    starts, goals = two_parts.airspace.start_goal_cells((4, 1, 0), (3, 0, 0))
    assert (starts.tolist(), goals.tolist()) == ([11], [3])


def dataset(blocked: np.ndarray, sinr: np.ndarray) -> xr.Dataset:
    nz, ny, nx = sinr.shape
    dims = ("z", "y", "x")
    return xr.Dataset(
        {
            "sinr_db": (dims, sinr),
            "sinr_std_db": (dims, np.full(sinr.shape, np.nan)),
            "blocked_reason": (dims, blocked.astype(np.uint8)),
        },
        {"x": np.arange(nx) * 20.0, "y": np.arange(ny) * 30.0, "z": 30.0 + np.arange(nz) * 20.0},
        {"blocked_reasons": '[{"name": "no measurement"}]'},
    )


def test_world_of_a_dataset_keeps_the_order_of_cells() -> None:
    sinr = np.arange(24.0).reshape(2, 3, 4)
    blocked = np.zeros(sinr.shape, bool)
    sinr[1, 2, 0], blocked[1, 2, 0] = np.nan, True
    sinr[0, 0, 1] = np.nan  # unknown but free: worse than any threshold
    world = World.from_map(dataset(blocked, sinr), 2.0)
    assert world.grid.sides == (4, 3, 2)
    assert world.signal.mean_db.dtype == np.float32
    assert world.signal.noise_std_db == 2.0
    for z, y, x in np.ndindex(sinr.shape):
        cell = int(world.grid.cell((x, y, z)))
        expected = -np.inf if (z, y, x) == (0, 0, 1) else sinr[z, y, x]
        np.testing.assert_equal(world.signal.mean_db[cell], np.float32(expected))
        assert world.airspace.blocked[cell] == blocked[z, y, x]
        np.testing.assert_array_equal(world.grid.metres(cell), (x * 20.0, y * 30.0, 30.0 + z * 20.0))
    assert not world.signal.std_db.any()
    assert world.signal.outage_probability(-1e6)[1] == 1.0


@settings(max_examples=15)
@given(st.integers(0, 2**31))
def test_every_cell_of_a_part_reaches_every_other(random_world: Callable[..., World], seed: int) -> None:
    world = random_world(seed, (5, 5, 1), 0.35)
    steps = world.airspace.shortest_steps(np.arange(world.grid.n_cells, dtype=np.int32))
    same = (
        (world.airspace.part[:, None] == world.airspace.part[None, :])
        & ~world.airspace.blocked[:, None]
        & ~world.airspace.blocked[None, :]
    )
    free = ~world.airspace.blocked[:, None] & ~world.airspace.blocked[None, :]
    np.testing.assert_array_equal(np.isfinite(steps)[free], same[free])
    np.testing.assert_array_equal(steps[free], steps.T[free])
