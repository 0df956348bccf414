"""The training loop outside compiled code: chunks, progress, checkpoints, interruption and resumption."""

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cellpilot.envs.arena import Arena
from cellpilot.errors import InputError
from cellpilot.learn.algorithms.base import AlgorithmSettings
from cellpilot.learn.algorithms.table import ALGORITHMS, TrainState
from cellpilot.learn.checkpoint import load_state, save_state
from cellpilot.learn.compile import compile_ahead, single_precision
from cellpilot.learn.history import mean_of_flights
from cellpilot.learn.seeds import compile_chunk
from cellpilot.policies.learned import PolicyParameters
from cellpilot.task import Task

CHECKPOINT_EVERY_S = 10.0
STOPS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
"""Signals that end a training with a checkpoint."""


@dataclass(frozen=True)
class TrainingProgress:
    """What a progress bar shows."""

    done: int  # episodes, or rounds
    rounds: int  # of the whole training
    return_mean: float  # of the flights that ended in the last chunk; NaN if none did
    reached_share: float  # of the same
    exploration: float
    histories: Callable[[], list[dict[str, np.ndarray]]]  # learning curve of each seed so far


@dataclass
class TrainingResult:
    """A finished or interrupted training."""

    settings: AlgorithmSettings
    seed: int
    state: TrainState
    history: dict[str, np.ndarray]  # episode_return, n_steps, reached, exploration `[rounds]`; NaN where no flight ended
    finished: bool
    train_wall_s: float  # without compilation, summed over resumed parts
    compile_s: float  # of this part

    @property
    def env_steps(self) -> int:
        """Steps flown, random ones included."""
        return int(self.state.env_steps)

    def policy_parameters(self, sides: tuple[int, int, int], about: dict[str, object]) -> PolicyParameters:
        """What was learned as plain NumPy weights that fly without JAX."""
        return ALGORITHMS[self.settings.algorithm].policy_parameters(self.state, self.settings, sides, about)


def train(
    settings: AlgorithmSettings,
    task: Task,
    arena: Arena,
    seed: int,
    *,
    checkpoint: Path | None = None,
    fingerprint: str = "",
    progress: Callable[[TrainingProgress], None] = lambda progress: None,
    chunk_rounds: int | None = None,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
    interrupted: Callable[[], bool] = lambda: False,
    noticed: Callable[[], None] = lambda: None,
) -> TrainingResult:
    """Train until all rounds are done or an interrupt arrives, going on from `checkpoint` if it exists.

    An interrupt is Ctrl-C in the main thread, which calls `noticed` at once, or `interrupted()` becoming true.

    `fingerprint` names map, task and settings; a checkpoint with another one is refused. The result is a function of
    (settings, task, arena, seed) on one machine, however often training was cut. FQI-HER also depends on the number of
    cores, among which the compiler divides its sums: `run.json` of a run has it.
    """
    return train_many(
        settings,
        task,
        arena,
        (seed,),
        checkpoints=(checkpoint,),
        fingerprint=fingerprint,
        progress=progress,
        chunk_rounds=chunk_rounds,
        checkpoint_every_s=checkpoint_every_s,
        interrupted=interrupted,
        noticed=noticed,
    )[0]


@single_precision
def train_many(
    settings: AlgorithmSettings,
    task: Task,
    arena: Arena,
    seeds: Sequence[int],
    *,
    checkpoints: Sequence[Path | None] | None = None,
    fingerprint: str = "",
    progress: Callable[[TrainingProgress], None] = lambda progress: None,
    chunk_rounds: int | None = None,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
    interrupted: Callable[[], bool] = lambda: False,
    noticed: Callable[[], None] = lambda: None,
) -> list[TrainingResult]:
    """`train` for several seeds in one compiled program, spread over all local devices; one result per seed.

    A seed's result is that of `train` with that seed up to rounding, because products of stacked matrices round
    differently. Training amplifies such differences, so over a long run the two part like two seeds do. Seeds whose
    checkpoints are behind the others catch up first. `checkpoints` are one per seed.
    """
    settings.check_fits(task)
    algorithm = ALGORITHMS[settings.algorithm]
    length = settings.chunk_rounds if chunk_rounds is None else chunk_rounds
    files = checkpoints or [None] * len(seeds)
    runs = [_open(settings, arena, seed, file, fingerprint) for seed, file in zip(seeds, files, strict=True)]
    clock = _Clock()

    def show(n: int) -> None:
        progress(_progress(settings, runs, n))

    def advance(group: list[_Run], until: int, stop: Callable[[], bool]) -> None:
        """Train runs that are equally far, until they are `until` far or `stop()`."""
        with clock.compiling():
            states, numbers = [run.state for run in group], [run.seed for run in group]
            program = compile_chunk(settings, task, arena, states, numbers, length)
        packed, saved = program.pack(states), time.perf_counter()
        while (done := group[0].done) < until and not stop():
            n = min(length, until - done)
            with clock.training(group):
                packed, rows = program.run(packed, n)
                for run, row in zip(group, rows, strict=True):
                    run.history = _append(run.history, row, n)
            if not _finite(algorithm.learned(packed)):
                raise InputError(f"training diverged after {done + n} {settings.counts}: lower learning_rate")
            show(n)
            if time.perf_counter() - saved > checkpoint_every_s * len(group):
                for run, state in zip(group, program.unpack(packed), strict=True):
                    run.save(state, fingerprint)
                saved = time.perf_counter()
        for run, state in zip(group, program.unpack(packed), strict=True):
            run.state = state

    if any(run.done for run in runs):
        show(length)
    with interruptible(noticed) as signalled:
        stop = lambda: signalled.is_set() or interrupted()
        fresh = [run for run in runs if run.fresh]
        if fresh and algorithm.fill_replay is not None:
            with clock.compiling():
                options = {"settings": settings, "task": task}
                fill = compile_ahead(algorithm.fill_replay, fresh[0].state, arena, jnp.int32(0), **options)
            with clock.training(fresh):
                for run in fresh:
                    run.state = jax.block_until_ready(fill(run.state, arena, jnp.int32(run.seed)))
        while (behind := min(run.done for run in runs)) < settings.rounds:
            until = min([run.done for run in runs if run.done > behind], default=settings.rounds)
            group = [run for run in runs if run.done == behind]
            advance(group, until, stop)
            if group[0].done < until:
                break
        for run in runs:
            run.save(run.state, fingerprint)
    return [run.result(settings, clock.compile_s) for run in runs]


@dataclass
class _Run:
    """The training of one seed so far."""

    seed: int
    state: Any
    history: dict[str, np.ndarray]
    checkpoint: Path | None
    fresh: bool  # nothing was read from a checkpoint
    train_wall_s: float

    @property
    def done(self) -> int:
        return len(self.history["episode_return"])

    def save(self, state: Any, fingerprint: str) -> None:
        if self.checkpoint is not None:
            about = {"fingerprint": fingerprint, "seed": self.seed, "train_wall_s": self.train_wall_s}
            save_state(self.checkpoint, state, self.history, about)

    def curve(self, settings: AlgorithmSettings) -> dict[str, np.ndarray]:
        exploration = ALGORITHMS[settings.algorithm].exploration_at(settings, jnp.arange(self.done))
        return self.history | {"exploration": np.asarray(exploration, np.float32)}

    def result(self, settings: AlgorithmSettings, compile_s: float) -> TrainingResult:
        history = self.curve(settings)
        finished = self.done >= settings.rounds
        return TrainingResult(settings, self.seed, self.state, history, finished, self.train_wall_s, compile_s)


def _open(settings: AlgorithmSettings, arena: Arena, seed: int, checkpoint: Path | None, fingerprint: str) -> _Run:
    """A new training, or the one in the checkpoint."""
    algorithm = ALGORITHMS[settings.algorithm]
    state = algorithm.initial_state(settings, arena, seed)
    empty = _columns(algorithm.empty_rows(0), 0)
    if checkpoint is None or not checkpoint.is_file():
        return _Run(seed, state, empty, checkpoint, True, 0.0)
    state, history, about = load_state(checkpoint, state, {"fingerprint": fingerprint, "seed": seed})
    if any(name not in history or history[name].shape != (int(state.rounds_done),) for name in empty):
        raise InputError(f"{checkpoint}: the learning curve in it is damaged; delete it to train from the start")
    if not _finite(algorithm.learned(state)):
        raise InputError(f"{checkpoint}: the weights in it are NaN or infinite; delete it to train from the start")
    return _Run(seed, state, history, checkpoint, False, about["train_wall_s"])


def _finite(network: Any) -> bool:
    return all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(network))


class _Clock:
    """Seconds of compilation, and of training, which each run in a group is given in full."""

    def __init__(self) -> None:
        self.compile_s = 0.0

    @contextmanager
    def compiling(self) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.compile_s += time.perf_counter() - started

    @contextmanager
    def training(self, runs: Sequence[_Run]) -> Iterator[None]:
        started = time.perf_counter()
        yield
        for run in runs:
            run.train_wall_s += time.perf_counter() - started


@contextmanager
def interruptible(noticed: Callable[[], None] = lambda: None) -> Iterator[threading.Event]:
    """Within this block Ctrl-C, a polite kill and a closed terminal only set the event: donated buffers are gone in a chunk.

    `noticed` is called at once, for a chunk or a compilation may take a while. A second Ctrl-C acts as usual. Outside the main
    thread nothing is changed.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = {number: signal.getsignal(number) for number in STOPS}

    def note(number: int, frame: FrameType | None) -> None:
        event.set()
        with suppress(OSError):  # the terminal that is told may be the one that has gone
            noticed()
        if signal.Signals(number).name != "SIGHUP":  # a terminal that closes sends it twice
            signal.signal(number, before[signal.Signals(number)])

    for number in before:
        signal.signal(number, note)
    try:
        yield event
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _columns(rows: Any, n: int) -> dict[str, np.ndarray]:
    """The first `n` rows of statistics by the names of their fields."""
    return {field.name: np.asarray(getattr(rows, field.name))[:n] for field in fields(rows)}


def _append(history: dict[str, np.ndarray], rows: Any, n: int) -> dict[str, np.ndarray]:
    return {name: np.concatenate([history[name], column]) for name, column in _columns(rows, n).items()}


def _progress(settings: AlgorithmSettings, runs: Sequence[_Run], n: int) -> TrainingProgress:
    """Means over the runs, of the last `n` rounds of each."""
    done = sum(run.done for run in runs) // len(runs)
    means = lambda name: [mean_of_flights(run.history, name, slice(-n, None)) for run in runs if run.done]
    last = lambda name: float(np.mean([mean for mean in means(name) if not np.isnan(mean)] or [np.nan]))
    return TrainingProgress(
        done=done,
        rounds=settings.rounds,
        return_mean=last("episode_return"),
        reached_share=last("reached"),
        exploration=float(ALGORITHMS[settings.algorithm].exploration_at(settings, jnp.int32(done))),
        histories=lambda: [run.curve(settings) for run in runs],
    )
