"""What is unknown of a map: drawn once, with the spread of each cell, and hanging together."""

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.signal import Signal, Unknown

GRID = Grid((0.0, 20.0, 60.0, 70.0), (0.0, 30.0, 40.0), (30.0, 50.0))


def test_errors_of_a_map_have_the_spread_and_the_correlation_that_are_stated() -> None:
    n = GRID.n_cells
    std_db = np.random.default_rng(0).uniform(0.5, 3.0, n).astype(np.float32)
    unknown = Unknown.of(GRID, std_db, 40.0)
    assert unknown is not None
    drawn_db = unknown.draw(np.random.default_rng(1).standard_normal((60_000, n), np.float32))
    np.testing.assert_allclose(drawn_db.std(0), std_db, rtol=0.02)
    away_m = np.abs(GRID.metres(np.arange(n))[:, None] - GRID.metres(np.arange(n))[None, :]).sum(-1)
    np.testing.assert_allclose(np.corrcoef(drawn_db.T), np.exp(-away_m / 40.0), atol=0.03)


def test_without_correlation_every_cell_is_drawn_for_itself() -> None:
    std_db = np.full(GRID.n_cells, 2.0, np.float32)
    unknown = Unknown.of(GRID, std_db, 0.0)
    assert unknown is not None
    normal = np.random.default_rng(0).standard_normal((3, GRID.n_cells), np.float32)
    np.testing.assert_array_equal(unknown.draw(normal), 2.0 * normal)


def test_a_map_that_is_known_has_nothing_to_draw() -> None:
    assert Unknown.of(GRID, np.zeros(GRID.n_cells, np.float32), 40.0) is None


@pytest.mark.parametrize("correlation_m", [-1.0, np.nan, np.inf])
def test_a_correlation_that_is_no_distance_is_refused(correlation_m: float) -> None:
    with pytest.raises(InputError, match="sinr_correlation_m"):
        Unknown.of(GRID, np.ones(GRID.n_cells, np.float32), correlation_m)


def test_a_measurement_is_mean_and_error_and_noise() -> None:
    signal = Signal(np.array([1.0, 5.0], np.float32), 2.0)
    found = signal.measure(np.array([1, 0]), np.array([0.5, -1.0], np.float32), np.array([1.0, -2.0], np.float32))
    np.testing.assert_array_equal(found, np.array([7.5, -4.0], np.float32))
    assert found.dtype == np.float32
    assert signal.measure(1) == np.float32(5.0)
