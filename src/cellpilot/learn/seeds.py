"""Chunks of training as compiled programs: of one seed, or of several at once, spread over all devices of the machine."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec

from cellpilot.envs.arena import Arena
from cellpilot.learn.algorithms.base import AlgorithmSettings
from cellpilot.learn.algorithms.table import ALGORITHMS
from cellpilot.learn.compile import compile_ahead
from cellpilot.task import Task

AXIS = "seed"


@dataclass(frozen=True)
class ChunkProgram:
    """`train_chunk` compiled for a number of seeds; their states travel as one tree, which `pack` makes and `unpack` opens."""

    n_seeds: int
    compiled: Any
    arguments: tuple[Any, ...]  # arena and seeds, on their devices

    def pack(self, states: Sequence[Any]) -> Any:
        """The states of all seeds as the program takes them."""
        return states[0] if self.n_seeds == 1 else _spread(_stack(states, _mesh(self.n_seeds)), _mesh(self.n_seeds))

    def unpack(self, packed: Any) -> list[Any]:
        """The state of each seed, to be saved or to go on in another program."""
        if self.n_seeds == 1:
            return [packed]
        host = jax.device_get(packed)
        return [jax.tree.map(lambda leaf, k=k: jnp.asarray(leaf[k]), host) for k in range(self.n_seeds)]

    def run(self, packed: Any, n_rounds: int) -> tuple[Any, list[Any]]:
        """`n_rounds` more rounds of every seed; the packed states (the old ones are gone) and each seed's rows of statistics."""
        arena, seeds = self.arguments
        packed, rows = self.compiled(packed, arena, seeds, np.int32(n_rounds))
        if self.n_seeds == 1:
            return packed, [rows]
        host = jax.device_get(rows)
        return packed, [jax.tree.map(lambda leaf, k=k: leaf[k], host) for k in range(self.n_seeds)]


def compile_chunk(
    settings: AlgorithmSettings, task: Task, arena: Arena, states: Sequence[Any], seeds: Sequence[int], length: int
) -> ChunkProgram:
    """Compile `train_chunk` for these seeds.

    One seed is the plain program. Several are mapped over a leading axis, and that axis is spread over the local devices;
    where it does not divide, the last seed is trained more than once.
    """
    train_chunk = partial(ALGORITHMS[settings.algorithm].train_chunk, settings=settings, task=task, length=length)
    if len(seeds) == 1:
        arguments = (arena, jnp.int32(seeds[0]))
        function = jax.jit(train_chunk, donate_argnums=0)
        return ChunkProgram(1, compile_ahead(function, states[0], *arguments, np.int32(0)), arguments)
    mesh = _mesh(len(seeds))
    each, same = PartitionSpec(AXIS), PartitionSpec()
    mapped = jax.vmap(train_chunk, (0, None, 0, None))
    spread = jax.shard_map(mapped, mesh=mesh, in_specs=(each, same, each, same), out_specs=each, check_vma=False)
    everywhere = jax.device_put(arena, NamedSharding(mesh, same))
    arguments = (everywhere, _spread(_stack([jnp.int32(seed) for seed in seeds], mesh), mesh))
    shapes = jax.eval_shape(partial(_stack, mesh=mesh), list(states))
    packed = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=NamedSharding(mesh, each)), shapes)
    compiled = compile_ahead(jax.jit(spread, donate_argnums=0), packed, *arguments, np.int32(0))
    return ChunkProgram(len(seeds), compiled, arguments)


def _mesh(n_seeds: int) -> Mesh:
    """The devices that `n_seeds` seeds are spread over."""
    return Mesh(np.array(jax.local_devices()[:n_seeds]), (AXIS,))


def _stack(trees: Sequence[Any], mesh: Mesh) -> Any:
    """One tree with a leading axis that the devices divide: the last tree is repeated to fill it up."""
    missing = -len(trees) % mesh.size
    return jax.tree.map(lambda *leaves: jnp.stack([*leaves, *leaves[-1:] * missing]), *trees)


def _spread(tree: Any, mesh: Mesh) -> Any:
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec(AXIS)))
