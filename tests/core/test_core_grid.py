from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot.airspace import MOVE_SETS, STOPPED, usual_moves
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.world import World

SIDES = st.tuples(st.integers(1, 6), st.integers(1, 6), st.integers(1, 4)).filter(lambda s: s[0] * s[1] * s[2] > 1)


def grid_of(sides: tuple[int, int, int], bin_m: float = 20.0) -> Grid:
    return Grid(*(tuple(i * bin_m - 35.0 for i in range(n)) for n in sides))


def test_actions_in_their_order() -> None:
    expected = {
        "north": (0, 1, 0),
        "south": (0, -1, 0),
        "east": (1, 0, 0),
        "west": (-1, 0, 0),
        "up": (0, 0, 1),
        "down": (0, 0, -1),
    }
    assert dict(zip(MOVE_SETS[6].names, MOVE_SETS[6].offsets, strict=True)) == expected
    assert MOVE_SETS[6].names[:4] == MOVE_SETS[4].names == MOVE_SETS[8].names[:4]


@given(SIDES)
def test_cells_are_counted_as_a_dataset_of_z_y_x(sides: tuple[int, int, int]) -> None:
    grid = grid_of(sides)
    cells = np.arange(grid.n_cells)
    positions = grid.position(cells)
    assert grid.n_cells == sides[0] * sides[1] * sides[2]
    np.testing.assert_array_equal(grid.cell(positions), cells)
    volume = cells.reshape(sides[::-1])
    np.testing.assert_array_equal(volume[positions[:, 2], positions[:, 1], positions[:, 0]], cells)


@given(SIDES, st.floats(1.0, 80.0))
def test_metres_round_trip(sides: tuple[int, int, int], bin_m: float) -> None:
    grid = grid_of(sides, bin_m)
    for cell in range(grid.n_cells):
        x_m, y_m, z_m = grid.metres(cell)
        position = tuple(grid.position(cell).tolist())
        assert (x_m, y_m, z_m) == (grid.x_m[position[0]], grid.y_m[position[1]], grid.z_m[position[2]])
        assert grid.nearest_position((x_m, y_m, z_m)) == position


@given(st.data())
def test_a_point_belongs_to_the_nearest_centre(data: st.DataObject) -> None:
    grid = Grid((0.0, 10.0, 30.0, 70.0), (0.0, 1.0), (30.0, 50.0, 90.0))
    point = tuple(data.draw(st.floats(low, high)) for low, high in ((-5.0, 90.0), (-0.5, 1.5), (20.0, 110.0)))
    found = grid.nearest_position(point)
    for index, value, centres in zip(found, point, (grid.x_m, grid.y_m, grid.z_m), strict=True):
        distance = [abs(value - c) for c in centres]
        inner = centres[0] <= value <= centres[-1]
        assert distance[index] <= min(distance) + 1e-9 or not inner
        if not inner:
            assert index == (0 if value < centres[0] else len(centres) - 1)


@pytest.mark.parametrize("point", [(-25.1, 0.0, 30.0), (25.1, 0.0, 30.0), (0.0, 45.0, 30.0), (0.0, -45.0, 30.0)])
def test_points_outside_are_refused(point: tuple[float, float, float]) -> None:
    grid = Grid((-20.0, -10.0, 0.0, 10.0, 20.0), (-20.0, 0.0, 20.0), (30.0,))
    with pytest.raises(InputError, match="outside the map"):
        grid.nearest_position(point)


def test_borders_of_the_map_belong_to_it_and_a_single_height_holds_for_any() -> None:
    grid = Grid((-10.0, 10.0), (0.0, 20.0), (30.0,))
    assert grid.nearest_position((-20.0, -10.0, 120.0)) == (0, 0, 0)
    assert grid.nearest_position((20.0, 30.0, 0.0)) == (1, 1, 0)
    with pytest.raises(InputError, match="z = 120 m"):
        Grid((0.0, 1.0), (0.0, 1.0), (30.0, 50.0)).nearest_position((0.0, 0.0, 120.0))


@pytest.mark.parametrize("position", [(3, 0, 0), (0, 4, 0), (0, 0, 2), (-1, 0, 0), (0, 0), (0, 0, 0, 0)])
def test_positions_off_the_grid_are_refused_by_name(position: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="start"):
        grid_of((3, 4, 2)).check_position(position, "start")


def test_corners_of_the_grid_are_on_it() -> None:
    grid = grid_of((3, 4, 2))
    assert grid.check_position((2, 3, 1), "goal") == (2, 3, 1)
    assert grid.check_position((0, 0, 0), "goal") == (0, 0, 0)


def test_two_and_three_dimensions() -> None:
    assert (grid_of((3, 4, 1)).n_dimensions, len(usual_moves(grid_of((3, 4, 1))))) == (2, 4)
    assert (grid_of((3, 4, 2)).n_dimensions, len(usual_moves(grid_of((3, 4, 2))))) == (3, 6)


def test_a_single_cell_is_no_grid() -> None:
    with pytest.raises(InputError, match="at least 2"):
        Grid((0.0,), (0.0,), (30.0,))


@given(SIDES, st.integers(0, 2**31), st.sampled_from([0.0, 0.2, 0.5]))
def test_next_cells_against_a_plain_stepper(
    random_world: Callable[..., World], plain: Callable, sides: tuple[int, int, int], seed: int, share: float
) -> None:
    if sides[0] == 1:
        sides = (2, *sides[1:])
    world = random_world(seed, sides, share)
    reference = plain(world)
    assert world.airspace.n_actions == len(reference.moves)
    cell = {position: i for i, position in enumerate(reference.positions)}
    for position in reference.positions:
        for action in range(world.airspace.n_actions):
            there, stopped = reference.step(position, action)
            assert world.airspace.next_cell[cell[position], action] == cell[there]
            assert (world.airspace.event[cell[position], action] == STOPPED) == stopped


@given(SIDES)
def test_manhattan_counts_single_moves(sides: tuple[int, int, int]) -> None:
    grid = grid_of(sides)
    goal = grid.n_cells - 1
    steps = grid.manhattan(np.arange(grid.n_cells), goal)
    far = np.array(sides) - 1
    np.testing.assert_array_equal(steps, [np.abs(far - p).sum() for p in grid.position(np.arange(grid.n_cells))])
