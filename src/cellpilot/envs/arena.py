"""`Arena`: what compiled code needs of a `World`, and the draw of a start and a goal."""

from dataclasses import dataclass, field, fields

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, UInt8

from cellpilot.envs.backend import check_backend
from cellpilot.grid import Position
from cellpilot.signal import Signal, Unknown
from cellpilot.world import World

jax.tree_util.register_dataclass(Unknown, [f.name for f in fields(Unknown)], [])
jax.tree_util.register_dataclass(Signal, [f.name for f in fields(Signal)], [])


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Arena:
    """A world on the device, and where flights begin and end; another world of the same size needs no new compilation."""

    signal: Signal  # its arrays on the device
    next_cell: Int[Array, "cells actions"]
    event: UInt8[Array, "cells actions"]
    not_offered: Float[Array, "cells actions"] | None  # -inf for an action that is not offered, else 0; None if all are
    coordinates: Float[Array, "cells dimensions"]  # network input: position counted from 1, divided by the side
    start_cells: Int[Array, " starts"]  # possible starts, grouped by connected part
    goal_cells: Int[Array, " goals"]  # possible goals, grouped by connected part
    part_chance: Float[Array, " parts"]  # share of all start-goal pairs that lies in each part
    start_offset: Int[Array, " parts"]
    start_count: Int[Array, " parts"]
    goal_offset: Int[Array, " parts"]
    goal_count: Int[Array, " parts"]
    part: Int[Array, " cells"]  # connected part of each cell, -1 in blocked cells
    may_be_goal: Bool[Array, " cells"]
    sides: Position = field(metadata={"static": True})
    ends: bool = field(metadata={"static": True})  # flights can end in blocked cells
    diagonal: bool = field(metadata={"static": True})  # a move may change several coordinates

    @property
    def n_cells(self) -> int:
        """Number of cells in all."""
        return self.next_cell.shape[-2]


def make_arena(world: World, start: Position | None = None, goal: Position | None = None) -> Arena:
    """The arena of a world; starts and goals are all free cells unless one is given.

    `InputError` for a given cell that is blocked or cut off, a start and a goal that cannot reach each other, or a JAX without
    a device.
    """
    check_backend()
    airspace = world.airspace
    starts, goals = airspace.start_goal_cells(start, goal)
    parts = np.intersect1d(airspace.part[starts], airspace.part[goals])
    starts, start_offset, start_count = _grouped(starts, airspace.part, parts)
    goals, goal_offset, goal_count = _grouped(goals, airspace.part, parts)
    shared = np.array([np.isin(starts[o : o + n], goals).sum() for o, n in zip(start_offset, start_count, strict=True)])
    pairs = start_count * goal_count - shared
    grid = world.grid
    position = grid.position(np.arange(grid.n_cells))[:, : grid.n_dimensions]
    return Arena(
        signal=_on_device(world.signal),
        next_cell=jnp.asarray(airspace.next_cell),
        event=jnp.asarray(airspace.event),
        not_offered=jnp.where(airspace.offered, 0.0, -jnp.inf) if airspace.rule == "mask" else None,
        coordinates=jnp.asarray((position + 1) / np.asarray(grid.sides[: grid.n_dimensions]), jnp.float32),
        start_cells=jnp.asarray(starts),
        goal_cells=jnp.asarray(goals),
        part_chance=jnp.asarray(pairs / pairs.sum(), jnp.float32),
        start_offset=jnp.asarray(start_offset),
        start_count=jnp.asarray(start_count),
        goal_offset=jnp.asarray(goal_offset),
        goal_count=jnp.asarray(goal_count),
        part=jnp.asarray(airspace.part),
        may_be_goal=jnp.asarray(np.isin(np.arange(grid.n_cells), goals)),
        sides=grid.sides,
        ends=airspace.ends,
        diagonal=airspace.moves.diagonal,
    )


def _on_device(signal: Signal) -> Signal:
    """Mean, spread and noise as device arrays; what compiled code has no use for is left out."""
    unknown = None if signal.unknown is None else jax.tree.map(jnp.asarray, signal.unknown)
    return Signal(jnp.asarray(signal.mean_db, jnp.float32), jnp.asarray(signal.noise_std_db, jnp.float32), unknown)


def draw_start_and_goal(key: Array, arena: Arena) -> tuple[Int[Array, ""], Int[Array, ""]]:
    """Start and goal, uniform over all pairs of different cells that can reach each other (equation 4.6)."""
    key_part, key_pair = jax.random.split(key)
    part = jnp.searchsorted(jnp.cumsum(arena.part_chance), jax.random.uniform(key_part), side="right")
    part = jnp.minimum(part, arena.part_chance.size - 1)

    def equal(carry: tuple[Array, Array, Array]) -> Array:
        _, start, goal = carry
        return start == goal

    def draw(carry: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
        attempt, _, _ = carry
        counts = jnp.stack([arena.start_count[part], arena.goal_count[part]])
        start, goal = draw_integers(jax.random.fold_in(key_pair, attempt), (2,), counts)
        start, goal = arena.start_offset[part] + start, arena.goal_offset[part] + goal
        return attempt + 1, arena.start_cells[start], arena.goal_cells[goal]

    same = jnp.zeros((), arena.start_cells.dtype)
    return jax.lax.while_loop(equal, draw, (jnp.int32(0), same, same))[1:]


def draw_integers(key: Array, shape: tuple[int, ...], high: Int[Array, "..."]) -> Int[Array, "..."]:
    """Integers in [0, high), one random word each, half of what `jax.random.randint` draws.

    Their chances differ by at most a share high / 2^32: 0.01 % for 500,000, 2 % for 100 million.
    """
    return (jax.random.bits(key, shape) % high.astype(jnp.uint32)).astype(jnp.int32)


def _grouped(cells: np.ndarray, part: np.ndarray, parts: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    cells = cells[np.isin(part[cells], parts)]
    cells = cells[np.argsort(part[cells], kind="stable")]
    count = np.array([(part[cells] == p).sum() for p in parts], dtype=np.int32)
    return cells.astype(np.int32), (np.cumsum(count) - count).astype(np.int32), count
