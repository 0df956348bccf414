"""The training loop outside compiled code: chunks, progress, checkpoints, interruption and resumption."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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
from cellpilot.learn.compile import compile_ahead
from cellpilot.policies.learned import PolicyParameters
from cellpilot.task import Task

CHECKPOINT_EVERY_S = 10.0


@dataclass(frozen=True)
class TrainingProgress:
    """What a progress bar shows."""

    done: int  # episodes, or rounds
    rounds: int  # of the whole training
    return_mean: float  # of the last chunk
    reached_share: float  # of the last chunk
    exploration: float


@dataclass
class TrainingResult:
    """A finished or interrupted training."""

    settings: AlgorithmSettings
    state: TrainState
    history: dict[str, np.ndarray]  # episode_return, n_steps, reached, exploration `[rounds]`
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
) -> TrainingResult:
    """Train until all rounds are done or an interrupt arrives, going on from `checkpoint` if it exists.

    An interrupt is Ctrl-C in the main thread, or `interrupted()` becoming true.

    `fingerprint` names map, task and settings; a checkpoint with another one is refused. The result is a function of
    (settings, task, arena, seed) on one machine, however often training was cut.
    """
    settings.check_fits(task)
    algorithm = ALGORITHMS[settings.algorithm]
    length = settings.chunk_rounds if chunk_rounds is None else chunk_rounds
    state = algorithm.initial_state(settings, arena, seed)
    history = _columns(algorithm.empty_rows(0), 0)
    about: dict[str, object] = {"fingerprint": fingerprint, "seed": seed, "train_wall_s": 0.0}
    resumed = checkpoint is not None and checkpoint.is_file()
    if checkpoint is not None and resumed:
        empty = history
        state, history, about = load_state(checkpoint, state, {"fingerprint": fingerprint, "seed": seed})
        if any(name not in history or history[name].shape != (int(state.rounds_done),) for name in empty):
            raise InputError(f"{checkpoint}: the learning curve in it is damaged; delete it to train from the start")
    wall_before_s = float(about["train_wall_s"])  # type: ignore[arg-type]
    seed_array = jnp.int32(seed)
    if int(state.rounds_done):
        progress(_progress(settings, history, state, length))
    with interruptible() as signalled:
        started = time.perf_counter()
        options = {"settings": settings, "task": task}
        fill = None
        if algorithm.fill_replay is not None and not resumed:
            fill = compile_ahead(algorithm.fill_replay, state, arena, seed_array, **options)
        chunk = compile_ahead(algorithm.train_chunk, state, arena, seed_array, jnp.int32(0), length=length, **options)
        compile_s = time.perf_counter() - started
        started = time.perf_counter()
        state = state if fill is None else fill(state, arena, seed_array)

        def save() -> None:
            if checkpoint is not None:
                about["train_wall_s"] = wall_before_s + time.perf_counter() - started
                save_state(checkpoint, state, history, about)

        saved = time.perf_counter()
        while (done := int(state.rounds_done)) < settings.rounds and not (signalled.is_set() or interrupted()):
            n = min(length, settings.rounds - done)
            state, rows = chunk(state, arena, seed_array, jnp.int32(n))
            history = _append(history, rows, n)
            if not all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(algorithm.learned(state))):
                raise InputError(f"training diverged after {done + n} {settings.counts}: lower learning_rate")
            progress(_progress(settings, history, state, n))
            if time.perf_counter() - saved > checkpoint_every_s:
                save()
                saved = time.perf_counter()
        finished = int(state.rounds_done) >= settings.rounds
        jax.block_until_ready(state)
        wall_s = wall_before_s + time.perf_counter() - started
        save()
    flown = jnp.arange(int(state.rounds_done))
    history = history | {"exploration": np.asarray(algorithm.exploration_at(settings, flown), np.float32)}
    return TrainingResult(settings, state, history, finished, wall_s, compile_s)


@contextmanager
def interruptible() -> Iterator[threading.Event]:
    """Within this block Ctrl-C and a polite kill only set the event: donated buffers are gone inside a chunk.

    A second Ctrl-C acts as usual. Outside the main thread nothing is changed.
    """
    event = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield event
        return
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}

    def note(number: int, frame: FrameType | None) -> None:
        event.set()
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


def _progress(settings: AlgorithmSettings, history: dict[str, np.ndarray], state: TrainState, n: int) -> TrainingProgress:
    return TrainingProgress(
        done=int(state.rounds_done),
        rounds=settings.rounds,
        return_mean=float(history["episode_return"][-n:].mean()),
        reached_share=float(history["reached"][-n:].mean()),
        exploration=float(ALGORITHMS[settings.algorithm].exploration_at(settings, state.rounds_done)),
    )
