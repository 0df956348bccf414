"""Compiled learners: rounds as one program, of one seed or of several at once, spread over all devices of the machine."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Int

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.learn.compile import compile_ahead
from cellpilot.learn.learner import History, Place
from cellpilot.policies.learned import PolicyParameters
from cellpilot.streams import Learning, learning_key
from cellpilot.task import Task

AXIS = "seed"


@dataclass(frozen=True)
class CompiledAlgorithm:
    """Functions of an algorithm as compiled code runs them; `settings` are static, `state` is a pytree."""

    initial_state: Callable[..., Any]  # (settings, arena, seed) -> state
    prepare_state: Callable[..., Any] | None  # (key, settings, arena, task, state) -> state, before the first round
    run_round: Callable[..., Any]  # (key, settings, arena, task, state) -> (state, row of statistics)
    empty_rows: Callable[[int], Any]  # length -> rows, a dataclass with at least episode_return and reached `[length]`
    exploration_at: Callable[..., Array]  # (settings, round `[...]`) -> `[...]`
    learned: Callable[[Any], Any]  # state -> the network that flies
    policy_parameters: Callable[..., PolicyParameters]  # (state, settings, sides, about) -> what flies without JAX


@partial(jax.jit, static_argnames=("algorithm", "settings", "task", "length"), donate_argnames="state")
def train_chunk(
    state: Any,
    arena: Arena,
    seed: Int[Array, ""],
    n_rounds: Int[Array, ""],
    *,
    algorithm: CompiledAlgorithm,
    settings: Any,
    task: Task,
    length: int,
) -> tuple[Any, Any]:
    """`n_rounds <= length` more rounds; rows of statistics `[length]`, real in the first `n_rounds`.

    Randomness is a function of (seed, round) alone: how rounds are split into chunks changes nothing.
    """
    key = learning_key(seed, Learning.ROUNDS)

    def body(i: Array, carry: tuple[Any, Any]) -> tuple[Any, Any]:
        state, rows = carry
        state, row = algorithm.run_round(key, settings, arena, task, state)
        return state, jax.tree.map(lambda all_rows, new: all_rows.at[i].set(new), rows, row)

    return jax.lax.fori_loop(0, n_rounds, body, (state, algorithm.empty_rows(length)))


@partial(jax.jit, static_argnames=("algorithm", "settings", "task"), donate_argnames="state")
def prepare_state(
    state: Any, arena: Arena, seed: Int[Array, ""], *, algorithm: CompiledAlgorithm, settings: Any, task: Task
) -> Any:
    """The state with what the algorithm stores before its first round."""
    assert algorithm.prepare_state is not None
    return algorithm.prepare_state(learning_key(seed, Learning.REPLAY_START), settings, arena, task, state)


@dataclass(frozen=True)
class CompiledLearner:
    """`learn.learner.Learner` of a compiled algorithm."""

    algorithm: CompiledAlgorithm
    settings: Any
    place: Place

    @cached_property
    def arena(self) -> Arena:
        """The place on the device."""
        return make_arena(self.place.world, self.place.start, self.place.goal)

    def initial_state(self, seed: int) -> Any:
        """Before anything is learned."""
        return self.algorithm.initial_state(self.settings, self.arena, seed)

    def preparation(self, state: Any) -> Callable[[Any, int], Any] | None:
        """The compiled filling of the replay memory, where the algorithm has one."""
        if self.algorithm.prepare_state is None:
            return None
        fill = compile_ahead(prepare_state, state, self.arena, jnp.int32(0), **self._bound)
        return lambda state, seed: jax.block_until_ready(fill(state, self.arena, jnp.int32(seed)))

    def program(self, states: Sequence[Any], seeds: Sequence[int], length: int) -> "CompiledProgram":
        """`train_chunk` compiled for these seeds.

        One seed is the plain program. Several are mapped over a leading axis, and that axis is spread over the local devices;
        where it does not divide, the last seed is trained more than once.
        """
        chunk = partial(train_chunk, length=length, **self._bound)
        if len(seeds) == 1:
            arguments = (self.arena, jnp.int32(seeds[0]))
            function = jax.jit(chunk, donate_argnums=0)
            return CompiledProgram(1, compile_ahead(function, states[0], *arguments, np.int32(0)), arguments)
        mesh = _mesh(len(seeds))
        each, same = PartitionSpec(AXIS), PartitionSpec()
        mapped = jax.vmap(chunk, (0, None, 0, None))
        spread = jax.shard_map(mapped, mesh=mesh, in_specs=(each, same, each, same), out_specs=each, check_vma=False)
        everywhere = jax.device_put(self.arena, NamedSharding(mesh, same))
        arguments = (everywhere, _spread(_stack([jnp.int32(seed) for seed in seeds], mesh), mesh))
        shapes = jax.eval_shape(partial(_stack, mesh=mesh), list(states))
        on_mesh = lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=NamedSharding(mesh, each))
        packed = jax.tree.map(on_mesh, shapes)
        compiled = compile_ahead(jax.jit(spread, donate_argnums=0), packed, *arguments, np.int32(0))
        return CompiledProgram(len(seeds), compiled, arguments)

    @property
    def no_history(self) -> History:
        """The statistics of a round as columns of length 0."""
        return _columns(self.algorithm.empty_rows(0), 0)

    def exploration_at(self, round_: np.ndarray) -> np.ndarray:
        """How much each round explores."""
        return np.asarray(self.algorithm.exploration_at(self.settings, jnp.asarray(round_)), np.float32)

    def learned(self, state: Any) -> Any:
        """The network that flies."""
        return self.algorithm.learned(state)

    def env_steps(self, state: Any) -> int:
        """Steps flown, random ones included."""
        return int(state.env_steps)

    def policy_parameters(self, state: Any, about: dict[str, Any]) -> PolicyParameters:
        """What was learned as plain NumPy arrays."""
        return self.algorithm.policy_parameters(state, self.settings, self.place.world.grid.sides, about)

    @property
    def _bound(self) -> dict[str, Any]:
        return {"algorithm": self.algorithm, "settings": self.settings, "task": self.place.task}


@dataclass(frozen=True)
class CompiledProgram:
    """`train_chunk` compiled for a number of seeds."""

    n_seeds: int
    compiled: Any
    arguments: tuple[Any, ...]  # arena and seeds, on their devices

    def pack(self, states: Sequence[Any]) -> Any:
        """The states of all seeds as the program takes them."""
        return states[0] if self.n_seeds == 1 else _spread(_stack(states, _mesh(self.n_seeds)), _mesh(self.n_seeds))

    def unpack(self, packed: Any) -> list[Any]:
        """The state of each seed."""
        if self.n_seeds == 1:
            return [packed]
        host = jax.device_get(packed)
        return [jax.tree.map(lambda leaf, k=k: jnp.asarray(leaf[k]), host) for k in range(self.n_seeds)]

    def run(self, packed: Any, n_rounds: int) -> tuple[Any, list[History]]:
        """`n_rounds` more rounds of every seed."""
        packed, rows = self.compiled(packed, *self.arguments, np.int32(n_rounds))
        host = jax.device_get(rows)
        row = lambda k: jax.tree.map(lambda leaf: leaf[k], host) if self.n_seeds > 1 else host
        return packed, [_columns(row(k), n_rounds) for k in range(self.n_seeds)]


def _columns(rows: Any, n: int) -> History:
    """The first `n` rows of statistics by the names of their fields."""
    return {field.name: np.asarray(getattr(rows, field.name))[:n] for field in fields(rows)}


def _mesh(n_seeds: int) -> Mesh:
    """The devices that `n_seeds` seeds are spread over."""
    return Mesh(np.array(jax.local_devices()[:n_seeds]), (AXIS,))


def _stack(trees: Sequence[Any], mesh: Mesh) -> Any:
    """One tree with a leading axis that the devices divide: the last tree is repeated to fill it up."""
    missing = -len(trees) % mesh.size
    return jax.tree.map(lambda *leaves: jnp.stack([*leaves, *leaves[-1:] * missing]), *trees)


def _spread(tree: Any, mesh: Mesh) -> Any:
    return jax.device_put(tree, NamedSharding(mesh, PartitionSpec(AXIS)))
