"""What the drone has measured, cell by cell: facts for replay, and the learned chance of low signal."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

LEAST_DB = -200.0
"""Stands for "no signal at all" [dB]."""

SPREAD_COUNT = 10.0
"""The spread common to all cells counts as so many measurements of each: few measurements do not tell their spread."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class CellMeasurements:
    """Sums over all measurements of a cell, relative to its first one so that equal ones cancel exactly, and the last few."""

    count: Int[Array, " cells"]
    first_db: Float[Array, " cells"]
    sum_db: Float[Array, " cells"]
    sum_squared_db: Float[Array, " cells"]
    last_db: Float[Array, "cells stored"]


def no_measurements(n_cells: int, stored: int) -> CellMeasurements:
    """Nothing measured yet."""
    zero = jnp.zeros(n_cells)
    return CellMeasurements(jnp.zeros(n_cells, jnp.int32), zero, zero, zero, jnp.zeros((n_cells, stored)))


def measure(memory: CellMeasurements, cell: Int[Array, " flights"], sinr_db: Float[Array, " flights"]) -> CellMeasurements:
    """Add one measurement of each flight."""
    sinr_db = jnp.maximum(sinr_db, LEAST_DB)
    seen = memory.count[cell] > 0
    first_db = memory.first_db.at[cell].set(jnp.where(seen, memory.first_db[cell], sinr_db))
    relative_db = sinr_db - first_db[cell]
    place = memory.count[cell] % memory.last_db.shape[1]
    # Flights that enter one cell together share a place; what they skip holds the first measurement, never nothing.
    last_db = memory.last_db.at[cell].set(jnp.where(seen[:, None], memory.last_db[cell], sinr_db[:, None]))
    return CellMeasurements(
        memory.count.at[cell].add(1),
        first_db,
        memory.sum_db.at[cell].add(relative_db),
        memory.sum_squared_db.at[cell].add(relative_db**2),
        last_db.at[cell, place].set(sinr_db),
    )


def penalty_model(memory: CellMeasurements, threshold_db: float) -> Float[Array, " cells"]:
    """Learned chance `[cells]` that a measurement falls below the threshold: normal with the cell's mean and spread.

    The spread of a cell is shrunk towards the one pooled over all cells; a cell never measured has the mean chance of
    all measurements.
    """
    count = memory.count.astype(jnp.float32)
    mean_db = memory.sum_db / jnp.maximum(count, 1)
    squares = jnp.maximum(memory.sum_squared_db - memory.sum_db * mean_db, 0)
    pooled = squares.sum() / jnp.maximum(count.sum() - (count > 0).sum(), 1)
    spread_db = jnp.sqrt((squares + SPREAD_COUNT * pooled) / (count + SPREAD_COUNT))
    margin_db = memory.first_db - threshold_db + mean_db
    chance = jax.scipy.special.ndtr(-margin_db / jnp.where(spread_db > 0, spread_db, 1.0))
    chance = jnp.where(spread_db > 0, chance, (margin_db < 0).astype(jnp.float32))
    usual = (chance * count).sum() / jnp.maximum(count.sum(), 1)
    return jnp.where(count > 0, chance, usual)


def replayed_penalty(key: Array, memory: CellMeasurements, threshold_db: float) -> Float[Array, " cells"]:
    """1 or 0 `[cells]`: whether one stored measurement of each cell, drawn at random, was low; 0 where there is none."""
    stored = jnp.minimum(memory.count, memory.last_db.shape[1])
    drawn = (jax.random.uniform(key, stored.shape) * stored).astype(jnp.int32)
    return ((memory.last_db[jnp.arange(stored.size), drawn] < threshold_db) & (stored > 0)).astype(jnp.float32)
