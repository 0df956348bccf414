"""Exact figures of a deterministic policy over every start-goal pair, without flying step by step.

For one goal such a policy is a function `next[cell]`. Composing it with itself doubles the number of steps, so the
state of every flight at the cap of 400 steps takes 9 compositions instead of 400 steps, and fewer where all arrive
earlier. The figures equal those of `exhaustive_summary`; what depends on the order of steps or draws (longest outage)
is left to it. All pairs of 20 x 20 x 5 cells, four million, take a few seconds.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import ENTERED, MOVED
from cellpilot.evaluate.statistics import weighted_quantile
from cellpilot.evaluate.summary import longest_shortest_path
from cellpilot.grid import IntArray
from cellpilot.policies import Policy
from cellpilot.task import Task
from cellpilot.world import World

GOALS_AT_ONCE = 32
FLAT = 1e-6
"""Below this difference of return between optimum and baseline there is nothing to score."""


@dataclass(frozen=True)
class PairFigures:
    """Every flight of a deterministic policy; entries where `valid` is False mean nothing."""

    goals: IntArray  # [goals]
    valid: NDArray[np.bool_]  # [n_cells, goals] start and goal differ and can reach each other
    expected_return: NDArray[np.float64]  # [n_cells, goals] undiscounted, in expectation over noise
    n_steps: IntArray  # [n_cells, goals] steps flown, the cap where the goal is not reached
    expected_low_steps: NDArray[np.float64]  # [n_cells, goals] steps below the threshold, in expectation over noise
    reached: NDArray[np.bool_]  # [n_cells, goals] within the cap


@dataclass(frozen=True)
class DeterministicFigures:
    """Exact figures over all pairs, defined as in `evaluate.metrics`."""

    n_pairs: int
    return_mean: float
    reached_share: float
    low_sinr_share: float
    n_steps_mean: float
    path_ratio_mean: float | None  # None where no flight reached its goal
    path_ratio_p50: float | None
    path_ratio_p90: float | None
    pairs: PairFigures | None = field(default=None, repr=False, compare=False)


def deterministic_figures(
    world: World, task: Task, policy: Policy, goals: IntArray | None = None, per_pair: bool = False
) -> DeterministicFigures:
    """Figures over every start and all free goals, or those given; with `per_pair` every flight as well.

    `ValueError` for a policy that is not deterministic or for goals without a single start.
    """
    if not policy.deterministic:
        raise ValueError(f"the policy {policy.name} is not deterministic; use exhaustive_summary")
    goals = world.airspace.free_cells if goals is None else np.asarray(goals, dtype=np.int32)
    width = longest_shortest_path(world, task) + 1
    arrivals = np.zeros((task.max_steps + 1, width))
    n_pairs, n_steps, low_steps, return_sum = 0, 0, 0.0, 0.0
    kept: list[PairFigures] = []
    for i in range(0, len(goals), GOALS_AT_ONCE):
        block = goals[i : i + GOALS_AT_ONCE]
        flights = fly_all(world, task, policy.action_probabilities(block).argmax(-1), block)
        valid, arrived = flights.valid, flights.valid & flights.reached
        shortest = world.airspace.shortest_steps(block)[arrived].astype(np.intp)
        place = flights.n_steps[arrived] * np.intp(width) + shortest
        arrivals += np.bincount(place, minlength=arrivals.size).reshape(arrivals.shape)
        n_pairs += int(valid.sum())
        n_steps += int(flights.n_steps[valid].sum(dtype=np.int64))
        low_steps += float(flights.expected_low_steps[valid].sum())
        return_sum += float(flights.expected_return[valid].sum())
        kept += [flights] if per_pair else []
    if not n_pairs:
        raise ValueError("no start can reach any of the goals")
    steps, shortest = np.nonzero(arrivals)
    ratio, mass = steps / shortest, arrivals[steps, shortest]
    return DeterministicFigures(
        n_pairs=n_pairs,
        return_mean=return_sum / n_pairs,
        reached_share=float(mass.sum() / n_pairs),
        low_sinr_share=low_steps / n_steps,
        n_steps_mean=n_steps / n_pairs,
        path_ratio_mean=float(ratio @ mass / mass.sum()) if mass.sum() else None,
        path_ratio_p50=weighted_quantile(ratio, mass, 0.5),
        path_ratio_p90=weighted_quantile(ratio, mass, 0.9),
        pairs=_joined(kept) if per_pair else None,
    )


def score(figures: DeterministicFigures, greedy: DeterministicFigures, optimal: DeterministicFigures) -> float | None:
    """(policy - greedy) / (optimal - greedy) of the mean returns, not clipped; None where those two return the same."""
    gain = optimal.return_mean - greedy.return_mean
    return (figures.return_mean - greedy.return_mean) / gain if abs(gain) >= FLAT else None


class _Leg(NamedTuple):
    """What some number of steps does to the flights that begin it, flat over (goal, cell)."""

    end: NDArray[np.intp]  # flat index of (goal, cell) after them
    reward: NDArray[np.float64]
    steps: IntArray
    low: NDArray[np.float64]

    def then(self, other: "_Leg") -> "_Leg":
        """This leg followed by another one."""
        return _Leg(
            other.end.take(self.end),
            self.reward + other.reward.take(self.end),
            self.steps + other.steps.take(self.end),
            self.low + other.low.take(self.end),
        )


def fly_all(world: World, task: Task, actions: NDArray[np.integer], goals: IntArray) -> PairFigures:
    """Every flight from every cell to each goal under `actions [n_cells, goals]`."""
    n_cells, n_goals = world.grid.n_cells, len(goals)
    goals = np.asarray(goals)
    airspace = world.airspace
    low_probability = world.outage_probability(task.threshold_db)
    cell, goal, action = np.arange(n_cells)[None, :], goals[:, None], np.ascontiguousarray(actions.T)
    reward = task.expected_outcome(world, cell, action, goal).reward
    next_cell = airspace.next_cell[cell, action]
    at_goal, over = task.end(cell, np.where(airspace.blocked, ENTERED, MOVED)[None, :], goal)
    flying = ~over
    # A flight that has ended stays where it is, at no cost.
    here = np.arange(n_goals * n_cells).reshape(n_goals, n_cells)
    one = _Leg(
        np.where(flying, next_cell + n_cells * np.arange(n_goals)[:, None], here).astype(np.intp).ravel(),
        np.where(flying, reward, 0.0).ravel(),
        flying.astype(np.int32).ravel(),
        np.where(flying, low_probability[next_cell], 0.0).ravel(),
    )
    valid = (flying & (airspace.part[cell] == airspace.part[goal])).ravel()
    over = over.ravel()
    whole = _up_to_the_cap(one, task.max_steps, lambda end: bool(over[end[valid]].all()))

    def by_cell(values: NDArray[Any]) -> NDArray[Any]:
        return values.reshape(n_goals, n_cells).T

    reached = at_goal.ravel()[whole.end]
    return PairFigures(goals, *(by_cell(x) for x in (valid, whole.reward, whole.steps, whole.low, reached)))


def _up_to_the_cap(one: _Leg, n_steps: int, all_over: Callable[[NDArray[np.intp]], bool]) -> _Leg:
    """`n_steps` steps, composed of powers of two after its binary digits; fewer compositions where all end earlier."""
    power, done = one, None
    while True:
        if all_over(power.end):
            return power
        if n_steps & 1:
            done = power if done is None else done.then(power)
        n_steps >>= 1
        if not n_steps:
            assert done is not None
            return done
        power = power.then(power)


def _joined(parts: list[PairFigures]) -> PairFigures:
    goals = np.concatenate([part.goals for part in parts])
    names = [name for name in PairFigures.__dataclass_fields__ if name != "goals"]
    return PairFigures(goals, *(np.concatenate([getattr(part, name) for part in parts], axis=1) for name in names))
