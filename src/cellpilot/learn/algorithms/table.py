"""The algorithms by name: a second learner is one file beside `ddqn_her.py` and one line here."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

from jaxtyping import Array, Int

from cellpilot.learn.algorithms import ddqn_her, fqi_her


@runtime_checkable
class TrainState(Protocol):
    """Everything that training changes: a pytree of arrays, of which the trainer reads two counters."""

    env_steps: Int[Array, "..."]

    @property
    def rounds_done(self) -> Int[Array, "..."]:
        """Episodes, or rounds, trained so far."""


@dataclass(frozen=True)
class Algorithm:
    """Functions that the trainer calls; `settings` is the algorithm's `AlgorithmSettings`.

    A round is whatever the algorithm repeats: an episode with its updates, or a step of many parallel flights with its
    updates. Randomness is a function of (seed, round) alone, so that neither chunks nor interruptions change a result.
    """

    initial_state: Callable[..., Any]  # (settings, arena, seed: int) -> state
    fill_replay: Any | None  # jitted (state, arena, seed, *, settings, task) -> state, before the first round
    train_chunk: Any  # jitted (state, arena, seed, n, *, settings, task, length) -> (state, rows `[length]`), n <= length
    empty_rows: Callable[[int], Any]  # length -> rows, a dataclass with at least episode_return and reached `[length]`
    exploration_at: Callable[..., Array]  # (settings, round `[...]`) -> `[...]`
    learned: Callable[[Any], Any]  # state -> the network that flies; training has diverged if it is not finite
    policy_parameters: Callable[..., Any]  # (state, settings, sides, about) -> PolicyParameters


ALGORITHMS = {
    "ddqn-her": Algorithm(
        initial_state=ddqn_her.initial_state,
        fill_replay=ddqn_her.fill_replay,
        train_chunk=ddqn_her.train_chunk,
        empty_rows=ddqn_her.empty_rows,
        exploration_at=ddqn_her.exploration_at,
        learned=lambda state: state.online,
        policy_parameters=ddqn_her.learned_policy,
    ),
    "fqi-her": Algorithm(
        initial_state=fqi_her.initial_state,
        fill_replay=None,
        train_chunk=fqi_her.train_chunk,
        empty_rows=fqi_her.empty_rows,
        exploration_at=fqi_her.exploration_at,
        learned=lambda state: state.average,
        policy_parameters=fqi_her.learned_policy,
    ),
}
