"""The training loop outside compiled code: chunks, progress, checkpoints, interruption and resumption."""

import signal
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from types import FrameType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.base import LearnerSettings
from cellpilot.learn.checkpoint import load_state, save_state
from cellpilot.learn.compile import single_precision
from cellpilot.learn.history import mean_of_flights
from cellpilot.learn.learner import History, Learner, Place
from cellpilot.policies.learned import PolicyParameters

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
    histories: Callable[[], list[History]]  # learning curve of each seed so far


@dataclass
class TrainingResult:
    """A finished or interrupted training."""

    settings: LearnerSettings
    learner: Learner
    seed: int
    state: Any
    history: History  # episode_return, n_steps, reached, exploration `[rounds]`; NaN where no flight ended
    finished: bool
    train_wall_s: float  # without compilation, summed over resumed parts
    compile_s: float  # of this part

    @property
    def env_steps(self) -> int:
        """Steps flown, random ones included."""
        return self.learner.env_steps(self.state)

    def policy_parameters(self, about: dict[str, object]) -> PolicyParameters:
        """What was learned as plain NumPy arrays that fly without JAX; `about` describes the training, and has the task."""
        return self.learner.policy_parameters(self.state, about)


def train_one(
    settings: LearnerSettings,
    place: Place,
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
    (settings, place, seed) on one machine, however often training was cut. FQI-HER also depends on the number of
    cores, among which the compiler divides its sums: `run.json` of a run has it.
    """
    return train_many(
        settings,
        place,
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
    settings: LearnerSettings,
    place: Place,
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
    settings.check_fits(place.task, place.world.grid, len(seeds))
    learner = settings.learner(place)
    length = settings.chunk_rounds if chunk_rounds is None else chunk_rounds
    files = checkpoints or [None] * len(seeds)
    runs = [_open(learner, seed, file, fingerprint) for seed, file in zip(seeds, files, strict=True)]
    clock = _Clock()

    def show(n: int) -> None:
        progress(_progress(settings, learner, runs, n))

    def advance(group: list[_Run], until: int, stop: Callable[[], bool]) -> None:
        """Train runs that are equally far, until they are `until` far or `stop()`."""
        with clock.compiling():
            states, numbers = [run.state for run in group], [run.seed for run in group]
            program = learner.program(states, numbers, length)
        packed, saved = program.pack(states), time.perf_counter()
        while (done := group[0].done) < until and not stop():
            n = min(length, until - done)
            with clock.training(group):
                packed, rows = program.run(packed, n)
                for run, row in zip(group, rows, strict=True):
                    run.history = {name: np.concatenate([run.history[name], row[name]]) for name in row}
            if not _finite(learner.learned(packed)):
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
        if fresh:
            with clock.compiling():
                prepare = learner.preparation(fresh[0].state)
            if prepare is not None:
                with clock.training(fresh):
                    for run in fresh:
                        run.state = prepare(run.state, run.seed)
        while (behind := min(run.done for run in runs)) < settings.n_rounds:
            until = min([run.done for run in runs if run.done > behind], default=settings.n_rounds)
            group = [run for run in runs if run.done == behind]
            advance(group, until, stop)
            if group[0].done < until:
                break
        for run in runs:
            run.save(run.state, fingerprint)
    return [run.result(settings, learner, clock.compile_s) for run in runs]


@dataclass
class _Run:
    """The training of one seed so far."""

    seed: int
    state: Any
    history: History
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

    def curve(self, learner: Learner) -> History:
        return self.history | {"exploration": learner.exploration_at(np.arange(self.done))}

    def result(self, settings: LearnerSettings, learner: Learner, compile_s: float) -> TrainingResult:
        history, finished = self.curve(learner), self.done >= settings.n_rounds
        return TrainingResult(settings, learner, self.seed, self.state, history, finished, self.train_wall_s, compile_s)


def _open(learner: Learner, seed: int, checkpoint: Path | None, fingerprint: str) -> _Run:
    """A new training, or the one in the checkpoint."""
    state = learner.initial_state(seed)
    empty = learner.no_history
    if checkpoint is None or not checkpoint.is_file():
        return _Run(seed, state, empty, checkpoint, True, 0.0)
    state, history, about = load_state(checkpoint, state, {"fingerprint": fingerprint, "seed": seed})
    if any(name not in history or history[name].shape != (int(state.rounds_done),) for name in empty):
        raise InputError(f"{checkpoint}: the learning curve in it is damaged; delete it to train from the start")
    if not _finite(learner.learned(state)):
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


def _progress(settings: LearnerSettings, learner: Learner, runs: Sequence[_Run], n: int) -> TrainingProgress:
    """Means over the runs, of the last `n` rounds of each."""
    done = sum(run.done for run in runs) // len(runs)
    means = lambda name: [mean_of_flights(run.history, name, slice(-n, None)) for run in runs if run.done]
    last = lambda name: float(np.mean([mean for mean in means(name) if not np.isnan(mean)] or [np.nan]))
    return TrainingProgress(
        done=done,
        rounds=settings.n_rounds,
        return_mean=last("episode_return"),
        reached_share=last("reached"),
        exploration=float(learner.exploration_at(np.array([done]))[0]),
        histories=lambda: [run.curve(learner) for run in runs],
    )
