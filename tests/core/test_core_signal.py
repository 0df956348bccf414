"""What is unknown of a map: drawn once, with the spread of each cell, and hanging together."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import cellpilot.envs.arena  # noqa: F401 (makes Unknown known to JAX)
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


@pytest.mark.parametrize("common_db", [0.4, 3.0])
def test_an_error_common_to_all_cells_and_the_rest_have_the_covariance_that_is_stated(common_db: float) -> None:
    n = GRID.n_cells
    std_db = np.random.default_rng(0).uniform(0.5, 3.0, n).astype(np.float32)
    std_db[3] = 0.0
    unknown = Unknown.of(GRID, std_db, 40.0, common_db)
    assert unknown is not None
    maps_db = unknown.draw(np.eye(n, dtype=np.float32)).astype(np.float64)
    share = np.minimum((common_db / np.maximum(std_db, 1e-3).astype(float)) ** 2, 1 - 1e-4) * (std_db > 0)
    away_m = np.abs(GRID.metres(np.arange(n))[:, None] - GRID.metres(np.arange(n))[None, :]).sum(-1)
    both = np.sqrt(np.outer(1 - share, 1 - share)) * np.exp(-away_m / 40.0) + np.sqrt(np.outer(share, share))
    np.testing.assert_allclose(maps_db.T @ maps_db, np.outer(std_db, std_db) * both, atol=1e-5 * 9)
    traced_db = jax.jit(lambda u, x: u.draw(x))(jax.tree.map(jnp.asarray, unknown), jnp.eye(n))
    np.testing.assert_allclose(traced_db, maps_db, atol=1e-4)


def test_a_common_error_makes_means_over_the_map_wider_and_seeds_decide_the_draw() -> None:
    std_db = np.full(GRID.n_cells, 2.0, np.float32)
    draw = lambda common_db, seed: Unknown.of(GRID, std_db, 0.0, common_db).draw(  # type: ignore[union-attr]
        np.random.default_rng(seed).standard_normal((4_000, GRID.n_cells), np.float32)
    )
    alone_db, common_db = draw(0.0, 1), draw(1.0, 1)
    assert alone_db.mean(1).std() == pytest.approx(2.0 / np.sqrt(GRID.n_cells), rel=0.05)
    assert common_db.mean(1).std() == pytest.approx(np.sqrt(1.0 + 3.0 / GRID.n_cells), rel=0.05)
    np.testing.assert_array_equal(common_db, draw(1.0, 1))
    assert not np.array_equal(common_db, draw(1.0, 2))


def test_a_map_that_is_known_has_nothing_to_draw() -> None:
    assert Unknown.of(GRID, np.zeros(GRID.n_cells, np.float32), 40.0) is None


@pytest.mark.parametrize("correlation_m", [-1.0, np.nan, np.inf])
def test_a_correlation_that_is_no_distance_is_refused(correlation_m: float) -> None:
    with pytest.raises(InputError, match="sinr_correlation_m"):
        Unknown.of(GRID, np.ones(GRID.n_cells, np.float32), correlation_m)


@pytest.mark.parametrize("common_db", [-1.0, np.nan, np.inf])
def test_a_common_error_that_is_no_spread_is_refused(common_db: float) -> None:
    with pytest.raises(InputError, match="sinr_common_std_db"):
        Unknown.of(GRID, np.ones(GRID.n_cells, np.float32), 40.0, common_db)


def test_a_measurement_is_mean_and_error_and_noise() -> None:
    signal = Signal(np.array([1.0, 5.0], np.float32), 2.0)
    found = signal.measure(np.array([1, 0]), np.array([0.5, -1.0], np.float32), np.array([1.0, -2.0], np.float32))
    np.testing.assert_array_equal(found, np.array([7.5, -4.0], np.float32))
    assert found.dtype == np.float32
    assert signal.measure(1) == np.float32(5.0)
