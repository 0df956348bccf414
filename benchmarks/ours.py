"""cellpilot's side of the benchmark: the whole training of the thesis, its update alone, and the arithmetic of one update."""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import pairwise

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from cellpilot.envs.arena import Arena, make_arena
from cellpilot.learn.algorithms.ddqn_episode import LearnerState
from cellpilot.learn.algorithms.ddqn_her import ALGORITHM, initial_state, optimize
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.compile import compile_ahead
from cellpilot.learn.compiled import prepare_state, train_chunk
from cellpilot.learn.learner import Place
from cellpilot.maps import simulate_map
from cellpilot.radio import hexagonal_deployment
from cellpilot.task import Task, default_max_steps
from cellpilot.world import World


@dataclass(frozen=True)
class Case:
    """What is trained: the two-dimensional task of the thesis on the default map, without measurement noise."""

    world: World
    task: Task
    settings: DDQNHER
    arena: Arena

    @property
    def place(self) -> Place:
        """Where it is trained."""
        return Place(self.world, self.task)

    @property
    def layer_sizes(self) -> tuple[int, ...]:
        """Widths of the thesis's network, input and output included: 4, 50, 50, 50, 4."""
        grid = self.world.grid
        return 2 * grid.n_dimensions, *self.settings.hidden, self.world.airspace.n_actions

    @property
    def updates(self) -> int:
        """Updates of the whole published run: 900,000."""
        return self.settings.episodes * self.settings.updates_per_episode


def thesis_case() -> Case:
    """The published two-dimensional run: settings of Table 4.3, reward of Table 4.2, 20 x 20 cells, cap of 400 steps."""
    world = World.from_map(simulate_map(hexagonal_deployment()))
    return Case(world, Task(max_steps=default_max_steps(world.grid)), DDQNHER(), make_arena(world))


@dataclass(frozen=True)
class TrainingSoFar:
    """Seconds spent and environment steps flown from the seed up to the end of a slice; waiting between slices excluded."""

    init_s: float  # networks, optimiser and the empty replay memory
    compile_s: float
    fill_s: float  # random flights until the replay memory may be used
    train_s: float
    fill_steps: int
    train_steps: int
    episodes: int

    def whole(self, episodes: int) -> tuple[float, float]:
        """Seconds and environment steps of `episodes` episodes; an extrapolation at constant rate unless all were flown."""
        share = episodes / self.episodes
        return self.init_s + self.compile_s + self.fill_s + self.train_s * share, self.fill_steps + self.train_steps * share


def train_in_slices(case: Case, seed: int, episodes: int, slices: int) -> Iterator[TrainingSoFar]:
    """Train for `episodes` episodes, as a user does, and hand over after each of `slices` equal parts.

    All compiled code is forgotten first, so every training pays its compilation. The exploration schedule is that of the
    full run even if fewer episodes are flown.
    """
    jax.clear_caches()
    began = time.perf_counter()
    state = jax.block_until_ready(initial_state(case.settings, case.arena, seed))
    init_s = time.perf_counter() - began

    length = -(-episodes // slices)
    jax_seed, options = jnp.int32(seed), {"algorithm": ALGORITHM, "settings": case.settings, "task": case.task}
    began = time.perf_counter()
    fill = compile_ahead(prepare_state, state, case.arena, jax_seed, **options)
    train = compile_ahead(train_chunk, state, case.arena, jax_seed, jnp.int32(length), length=length, **options)
    compile_s = time.perf_counter() - began

    began = time.perf_counter()
    state = jax.block_until_ready(fill(state, case.arena, jax_seed))
    fill_s, fill_steps = time.perf_counter() - began, int(state.env_steps)

    train_s, flown = 0.0, 0
    while flown < episodes:
        part = min(length, episodes - flown)
        began = time.perf_counter()
        state, _ = jax.block_until_ready(train(state, case.arena, jax_seed, jnp.int32(part)))
        train_s += time.perf_counter() - began
        flown += part
        yield TrainingSoFar(init_s, compile_s, fill_s, train_s, fill_steps, int(state.env_steps) - fill_steps, flown)


def make_update(case: Case, rounds: int) -> Callable[[], float]:
    """A function that runs `rounds` times the updates of one episode and returns the seconds per update.

    The replay memory is full (500,000 experiences), nothing is flown, and compilation is over before it is first called.
    """
    full = DDQNHER(replay_start=case.settings.replay_capacity)
    state = prepare_state(
        initial_state(full, case.arena, 0), case.arena, jnp.int32(0), algorithm=ALGORITHM, settings=full, task=case.task
    )

    def run(state: LearnerState, arena: Arena, key: Array) -> tuple[eqx.Module, object]:
        learning = lambda s: (s.online, s.optimizer)

        def body(i: Array, carry: tuple[eqx.Module, object]) -> tuple[eqx.Module, object]:
            now = eqx.tree_at(learning, state, carry)
            return learning(optimize(jax.random.fold_in(key, i), case.settings, arena, case.task, now))

        return jax.lax.fori_loop(0, rounds, body, learning(state))

    compiled = compile_ahead(jax.jit(run), state, case.arena, jax.random.key(0))
    keys = iter(range(1, 1_000_000))

    def seconds_per_update() -> float:
        key = jax.block_until_ready(jax.random.key(next(keys)))
        began = time.perf_counter()
        jax.block_until_ready(compiled(state, case.arena, key))
        return (time.perf_counter() - began) / (rounds * case.settings.updates_per_episode)

    return seconds_per_update


def flop_per_update(layer_sizes: tuple[int, ...], batch_size: int) -> int:
    """Floating-point operations of the matrix products of one DDQN update.

    Three forward passes (online and target network at s', online network at s) and one backward pass: the gradient of
    every weight and of every input but the first layer's. Activations, loss and Adam are left out: a lower bound.
    """
    products = [2 * batch_size * a * b for a, b in pairwise(layer_sizes)]
    return 3 * sum(products) + sum(products) + sum(products[1:])


def make_matrix_product(case: Case, rounds: int) -> Callable[[], float]:
    """A function that returns this machine's FLOP/s in the product of a hidden layer, which is nearly all of the work.

    `rounds` products [batch, width] x [width, width] on one core, in one compiled loop and through NumPy's library with the
    result written in place; the faster counts, because a bound has to be one.
    """
    batch, width = case.settings.batch_size, case.settings.hidden[0]
    flop = 2 * batch * width * width * rounds
    rng = np.random.default_rng(0)
    weight = np.linalg.qr(rng.standard_normal((width, width)))[0].astype(np.float32)  # orthogonal: neither grows nor vanishes
    x = rng.standard_normal((batch, width)).astype(np.float32)
    device_x, device_weight = jnp.asarray(x), jnp.asarray(weight)
    chain = jax.jit(lambda x, w: jax.lax.fori_loop(0, rounds, lambda _, x: x @ w, x)).lower(device_x, device_weight).compile()
    out = np.empty_like(x)

    def flop_per_second() -> float:
        began = time.perf_counter()
        jax.block_until_ready(chain(device_x, device_weight))
        compiled_s = time.perf_counter() - began
        began = time.perf_counter()
        for _ in range(rounds):
            np.matmul(x, weight, out=out)
        return flop / min(compiled_s, time.perf_counter() - began)

    return flop_per_second
