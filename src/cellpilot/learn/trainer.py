"""The training loop outside compiled code: chunks, progress, checkpoints, interruption and resumption."""

import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import FrameType

import jax
import jax.numpy as jnp
import numpy as np

from cellpilot.envs.arena import Arena
from cellpilot.errors import InputError
from cellpilot.learn.algorithms.ddqn_her import (
    EpisodeStatistics,
    LearnerState,
    exploration_at,
    fill_replay,
    initial_state,
    train_chunk,
)
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, check_fits
from cellpilot.learn.checkpoint import load_state, save_state
from cellpilot.task import Task

CHUNK_EPISODES = 250
"""Episodes between two looks at progress, interruption and the clock; changes no result."""

CHECKPOINT_EVERY_S = 10.0

HISTORY = ("episode_return", "n_steps", "reached")


@dataclass(frozen=True)
class TrainingProgress:
    """What a progress bar shows."""

    episode: int
    episodes: int
    return_mean: float  # of the last chunk
    reached_share: float  # of the last chunk
    exploration: float


@dataclass
class TrainingResult:
    """A finished or interrupted training."""

    state: LearnerState
    history: dict[str, np.ndarray]  # episode_return, n_steps, reached, exploration `[episodes]`
    finished: bool
    train_wall_s: float  # without compilation, summed over resumed parts
    compile_s: float  # of this part

    @property
    def env_steps(self) -> int:
        """Steps flown, random ones included."""
        return int(self.state.env_steps)


def train(
    settings: DDQNHER,
    task: Task,
    arena: Arena,
    seed: int,
    *,
    checkpoint: Path | None = None,
    fingerprint: str = "",
    progress: Callable[[TrainingProgress], None] = lambda progress: None,
    chunk_episodes: int = CHUNK_EPISODES,
    checkpoint_every_s: float = CHECKPOINT_EVERY_S,
    interrupted: Callable[[], bool] = lambda: False,
) -> TrainingResult:
    """Train until all episodes are flown or an interrupt arrives, going on from `checkpoint` if it exists.

    An interrupt is Ctrl-C in the main thread, or `interrupted()` becoming true.

    `fingerprint` names map, task and settings; a checkpoint with another one is refused. The result is a function of
    (settings, task, arena, seed) on one machine, however often training was cut.
    """
    check_fits(settings, task)
    state = initial_state(settings, arena, seed)
    history = {name: np.empty(0, dtype) for name, dtype in zip(HISTORY, (np.float32, np.int32, bool), strict=True)}
    about: dict[str, object] = {"fingerprint": fingerprint, "seed": seed, "train_wall_s": 0.0}
    resumed = checkpoint is not None and checkpoint.is_file()
    if checkpoint is not None and resumed:
        empty = history
        state, history, about = load_state(checkpoint, state, {"fingerprint": fingerprint, "seed": seed})
        if any(name not in history or history[name].shape != (int(state.episode),) for name in empty):
            raise InputError(f"{checkpoint}: the learning curve in it is damaged; delete it to train from the start")
    wall_before_s = float(about["train_wall_s"])  # type: ignore[arg-type]
    seed_array = jnp.int32(seed)
    if len(history["reached"]):
        progress(_progress(settings, history, state, chunk_episodes))
    with interruptible() as signalled:
        started = time.perf_counter()
        fill = None if resumed else fill_replay.lower(state, arena, seed_array, settings=settings, task=task).compile()
        n_most = jnp.int32(0)
        chunk = train_chunk.lower(state, arena, seed_array, n_most, settings=settings, task=task, length=chunk_episodes).compile()
        compile_s = time.perf_counter() - started
        started = time.perf_counter()
        state = state if fill is None else fill(state, arena, seed_array)

        def save() -> None:
            if checkpoint is not None:
                about["train_wall_s"] = wall_before_s + time.perf_counter() - started
                save_state(checkpoint, state, history, about)

        saved = time.perf_counter()
        while (episode := int(state.episode)) < settings.episodes and not (signalled.is_set() or interrupted()):
            n = min(chunk_episodes, settings.episodes - episode)
            state, rows = chunk(state, arena, seed_array, jnp.int32(n))
            history = _append(history, rows, n)
            if not all(bool(jnp.isfinite(leaf).all()) for leaf in jax.tree.leaves(state.online)):
                raise InputError(f"training diverged after {episode + n} episodes: lower learning_rate")
            progress(_progress(settings, history, state, n))
            if time.perf_counter() - saved > checkpoint_every_s:
                save()
                saved = time.perf_counter()
        finished = int(state.episode) >= settings.episodes
        jax.block_until_ready(state)
        wall_s = wall_before_s + time.perf_counter() - started
        save()
    flown = jnp.arange(len(history["reached"]))
    history = history | {"exploration": np.asarray(exploration_at(settings, flown), np.float32)}
    return TrainingResult(state, history, finished, wall_s, compile_s)


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


def _append(history: dict[str, np.ndarray], rows: EpisodeStatistics, n: int) -> dict[str, np.ndarray]:
    return {name: np.concatenate([column, np.asarray(getattr(rows, name))[:n]]) for name, column in history.items()}


def _progress(settings: DDQNHER, history: dict[str, np.ndarray], state: LearnerState, n: int) -> TrainingProgress:
    return TrainingProgress(
        episode=int(state.episode),
        episodes=settings.episodes,
        return_mean=float(history["episode_return"][-n:].mean()),
        reached_share=float(history["reached"][-n:].mean()),
        exploration=float(exploration_at(settings, state.episode)),
    )
