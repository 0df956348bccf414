"""Instances: the start-goal pairs that an evaluation flies, every policy the same ones."""

from dataclasses import dataclass

import numpy as np

from cellpilot.grid import IntArray, Position
from cellpilot.world import World


@dataclass(frozen=True)
class Instances:
    """Pairs of different cells that can reach each other, and how many pairs cannot."""

    start: IntArray  # [flights]
    goal: IntArray  # [flights]
    unreachable_pairs: int  # pairs of different free cells in separate parts, counted apart


def count_pairs(world: World, start: Position | None = None, goal: Position | None = None) -> tuple[int, int]:
    """Number of start-goal pairs (different, connected), and of those cut apart by blocked cells."""
    starts, goals = world.airspace.start_goal_cells(start, goal)
    both = np.intersect1d(starts, goals).size
    parts = int(world.airspace.part.max()) + 1
    here, there = (np.bincount(world.airspace.part[cells], minlength=parts).astype(np.int64) for cells in (starts, goals))
    connected = int((here * there).sum())
    return connected - both, len(starts) * len(goals) - connected


def all_pairs(world: World, goals: IntArray, start: Position | None = None) -> tuple[IntArray, IntArray]:
    """Every start for each of these goals, as two arrays `[flights]`."""
    starts, _ = world.airspace.start_goal_cells(start)
    s, g = (axis.ravel() for axis in np.meshgrid(starts, goals, indexing="ij"))
    keep = (s != g) & (world.airspace.part[s] == world.airspace.part[g])
    return s[keep], g[keep]


def sample_pairs(
    rng: np.random.Generator,
    world: World,
    n: int,
    start: Position | None = None,
    goal: Position | None = None,
    n_goals: int | None = None,
) -> Instances:
    """`n` pairs drawn uniformly, with replacement, from all pairs that can reach each other.

    With `n_goals` they lead to at most so many goals, drawn first in the same way.
    """
    starts, goals = world.airspace.start_goal_cells(start, goal)
    if n_goals is not None and n_goals < len(goals):
        goals = np.unique(world.airspace.draw_pairs(rng, n_goals, starts, goals)[1])
    return Instances(*world.airspace.draw_pairs(rng, n, starts, goals), count_pairs(world, start, goal)[1])
