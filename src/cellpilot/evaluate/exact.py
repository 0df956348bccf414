"""Exact figures: every start-goal pair, in expectation over noise and over the actions of a stochastic policy.

Both kinds of policy need two things for each goal: when flights arrive, and how often each cell is left.

* For one goal a deterministic policy is a function `next[cell]`. Composing it with itself doubles the number of steps, so
  that all flights up to the cap of 400 steps take 9 compositions, and fewer where all end earlier.
* A stochastic one needs two recursions up to the cap: backwards for the chance to arrive after exactly t steps, forwards
  for how often each cell is left.

The longest outage depends on the order of draws; it alone comes from drawn flights: one per pair for a deterministic
policy, evenly spread over the pairs for a stochastic one.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import ENTERED, MOVED
from cellpilot.array_types import FloatArray
from cellpilot.evaluate.flights import Departures, longest_outages
from cellpilot.evaluate.instances import all_pairs, count_pairs
from cellpilot.evaluate.summary import Summary, expected_sinr_histogram, longest_shortest_path, steps_by_height
from cellpilot.grid import IntArray, Position
from cellpilot.policies import Policy
from cellpilot.task import Task
from cellpilot.world import World

GOALS_AT_ONCE = 40
MOST_PAIRS = 4_000_000
"""Cells times goals of one table of probabilities."""

DRAWN_FLIGHTS = 250_000
"""At most about so many flights are drawn for the longest outage of a stochastic policy."""

NEGLIGIBLE = 1e-13
"""A recursion ends when no start has more than this chance of still being in the air."""


def goals_at_once(world: World) -> int:
    """Goals for which probabilities are held in memory at once."""
    return max(1, min(GOALS_AT_ONCE, MOST_PAIRS // world.grid.n_cells))


def exhaustive_summary(
    rng: np.random.Generator | None,
    world: World,
    task: Task,
    policy: Policy,
    start: Position | None = None,
    goal: Position | None = None,
    progress: Callable[[float], None] = lambda share: None,
    goals: IntArray | None = None,
) -> Summary:
    """Exact sums over every pair of start and goal, or over those that lead to the cells `goals`.

    `rng` draws the flights behind the longest outage; without it that figure is missing. `ValueError` if no start can reach
    any goal.
    """
    if goals is None:
        _, goals = world.airspace.start_goal_cells(start, goal)
    at_once = goals_at_once(world)
    draw_every = 1 if policy.deterministic else 1 + count_pairs(world, start, goal)[0] // DRAWN_FLIGHTS
    total: Summary | None = None
    for i in range(0, len(goals), at_once):
        block = np.asarray(goals[i : i + at_once])
        part = _block_summary(rng, world, task, policy, block, start, draw_every)
        total = part if total is None else total + part
        progress(min(1.0, (i + at_once) / len(goals)))
    if total is None or not total.n_flights:
        raise ValueError("no start can reach any of the goals")
    return total


def _block_summary(
    rng: np.random.Generator | None,
    world: World,
    task: Task,
    policy: Policy,
    goals: IntArray,
    start: Position | None,
    draw_every: int,
) -> Summary:
    probabilities = policy.action_probabilities(goals)
    starts, goal = all_pairs(world, goals, start)
    order = np.argsort(goals)
    column = order[np.searchsorted(goals, goal, sorter=order)]
    outages = np.zeros(task.max_steps + 1)
    if rng is not None:
        some = Departures(probabilities, goals, starts[::draw_every], column[::draw_every])
        outages += np.bincount(longest_outages(rng, world, task, some), minlength=outages.size)
    departures = np.zeros((world.grid.n_cells, len(goals)))
    departures[starts, column] = 1.0
    width = longest_shortest_path(world, task) + 1
    shortest = np.where(departures > 0, np.minimum(world.airspace.shortest_steps(goals), width - 1), 0).astype(np.intp)
    figures = _deterministic if policy.deterministic else _stochastic
    block = _Block(probabilities, goals, departures, shortest, width)
    arrivals, time_in_cell, entered, return_sum = figures(world, task, block)
    return Summary(
        n_flights=float(len(starts)),
        arrivals=arrivals,
        n_steps=float(time_in_cell.sum()),
        low_steps=float(world.outage_probability(task.threshold_db) @ entered),
        return_sum=return_sum,
        steps_by_height=steps_by_height(entered, world),
        sinr_histogram=expected_sinr_histogram(entered, world),
        outages=outages,
    )


class _Block(NamedTuple):
    """Some goals, the policy that leads there, and the flights that depart."""

    probabilities: NDArray[np.float32]  # [n_cells, goals, actions]
    goals: IntArray  # [goals]
    departures: FloatArray  # [n_cells, goals] flights from each cell
    shortest: NDArray[np.intp]  # [n_cells, goals] steps of the shortest allowed path, below `width`; 0 where none departs
    width: int  # of tables over shortest paths


class _Figures(NamedTuple):
    """What both kinds of policy need."""

    arrivals: FloatArray  # [steps, shortest]
    time_in_cell: FloatArray  # [n_cells, goals] how often each cell is left
    entered: FloatArray  # [n_cells] how often each cell is entered
    return_sum: float  # expected, undiscounted


def _deterministic(world: World, task: Task, block: _Block) -> _Figures:
    probabilities, goals, departures, shortest, width = block
    actions = probabilities.argmax(-1)
    n_steps, reached, time_in_cell = fly_all(world, task, actions, goals, departures)
    arrived = (departures > 0) & reached
    place = n_steps[arrived] * np.intp(width) + shortest[arrived]
    arrivals = np.bincount(place, minlength=(task.max_steps + 1) * width).reshape(-1, width).astype(float)
    cell = np.arange(world.grid.n_cells)[:, None]
    next_cell = world.airspace.next_cell[cell, actions]
    entered = np.bincount(next_cell.ravel(), time_in_cell.ravel(), minlength=world.grid.n_cells).astype(float)
    reward = task.expected_outcome(world, cell, actions, goals[None, :]).reward
    return _Figures(arrivals, time_in_cell, entered, float((time_in_cell * reward).sum()))


def _stochastic(world: World, task: Task, block: _Block) -> _Figures:
    exact = block.probabilities.astype(np.float64)
    exact /= exact.sum(-1, keepdims=True)  # float32 rows sum to 1 only within 1e-7, which 400 steps would compound
    chance = [np.ascontiguousarray(exact[..., action]) for action in range(world.airspace.n_actions)]
    arrivals, in_the_air = _arrivals(world, task, chance, block)
    time_in_cell = _time_in_cells(world, chance, block, in_the_air)
    entered = _push(world, chance, time_in_cell).sum(1)
    return _Figures(arrivals, time_in_cell, entered, _expected_return(world, task, chance, block.goals, time_in_cell))


def _expected_return(world: World, task: Task, chance: list[FloatArray], goals: IntArray, time_in_cell: FloatArray) -> float:
    """Expected return over all flights, undiscounted."""
    cell, total = np.arange(world.grid.n_cells)[:, None], 0.0
    for action, pi in enumerate(chance):
        reward = task.expected_outcome(world, cell, action, goals[None, :]).reward
        total += float((time_in_cell * pi * reward).sum())
    return total


def fly_all(
    world: World, task: Task, actions: NDArray[np.integer], goals: IntArray, departures: FloatArray
) -> tuple[IntArray, NDArray[np.bool_], FloatArray]:
    """Flights of a deterministic policy from every cell to each goal under `actions [n_cells, goals]`.

    Steps flown up to the cap, and whether the goal was reached within it, `[n_cells, goals]` from each cell; and how often
    each cell is left, `[n_cells, goals]`, when so many flights depart there as `departures [n_cells, goals]` says.
    """
    n_cells, n_goals = departures.shape
    cell, goal, action = np.arange(n_cells)[None, :], goals[:, None], np.ascontiguousarray(actions.T)
    at_goal, over = task.end(cell, np.where(world.airspace.blocked, ENTERED, MOVED)[None, :], goal)
    here = np.arange(n_goals * n_cells).reshape(n_goals, n_cells)
    leads = world.airspace.next_cell[cell, action] + n_cells * np.arange(n_goals)[:, None]
    # A flight that has ended stays where it is. A state is a pair (goal, cell), all of them in one row.
    over = over.ravel()
    power, power_steps = np.where(over, here.ravel(), leads.ravel()).astype(np.intp), (~over).astype(np.int32)
    mass = np.ascontiguousarray(departures.T).ravel()
    flown = mass > 0
    end, steps, time, left = here.ravel(), np.zeros(here.size, np.int32), np.zeros(here.size), task.max_steps
    push = lambda through, weights: np.bincount(through, weights, minlength=here.size)
    # `mass` counts where flights are in the first 1, 2, 4, ... steps; `end`, `steps` and `time` hold the steps of the
    # binary digits of the cap so far.
    while left:
        if over[power[flown]].all():
            end, steps, time = power, power_steps, mass
            break
        if left & 1:
            time = time + push(end, mass)
            end, steps = power[end], steps + power_steps[end]
        left >>= 1
        if left:
            mass = mass + push(power, mass)
            power, power_steps = power[power], power_steps + power_steps[power]

    def by_cell(values: NDArray[np.generic]) -> NDArray[np.generic]:
        return values.reshape(n_goals, n_cells).T

    return by_cell(steps), by_cell(at_goal.ravel()[end]), by_cell(np.where(over, 0.0, time))  # type: ignore[return-value]


def _arrivals(world: World, task: Task, chance: list[FloatArray], block: _Block) -> tuple[FloatArray, int]:
    """Arrivals `[steps, shortest]`, and the number of steps after which nobody is in the air any more.

    f_t(s) = sum_a pi(a|s) f_{t-1}(s'), where f_0 is 1 at the goal and 0 elsewhere, and f_t = 0 for t > 0 where flights end.
    Who has ended elsewhere counts as in the air here, for ever.
    """
    _, goals, departures, shortest, width = block
    at_goal = (goals, np.arange(len(goals)))
    arrivals = np.zeros((task.max_steps + 1, width))
    hit = np.zeros_like(departures)
    hit[at_goal] = 1.0
    flying = departures.copy()
    for t in range(1, task.max_steps + 1):
        new = np.zeros_like(hit)
        for action, pi in enumerate(chance):
            new += pi * hit[world.airspace.next_cell[:, action]]
        new[at_goal] = 0.0
        new[world.airspace.blocked] = 0.0
        hit = new
        arrivals[t] = np.bincount(shortest.ravel(), (hit * departures).ravel(), minlength=width)
        flying -= hit * departures
        if flying.max() < NEGLIGIBLE:
            return arrivals, t
    return arrivals, task.max_steps


def _time_in_cells(world: World, chance: list[FloatArray], block: _Block, n_steps: int) -> FloatArray:
    """How often each cell is left, `[n_cells, goals]`.

    Moves m_{t+1}(s') = sum over (s, a) that lead to s' of m_t(s) pi(a|s); mass where flights end leaves.
    """
    at_goal = (block.goals, np.arange(len(block.goals)))
    time_in_cell = np.zeros_like(block.departures)
    flying = block.departures.copy()
    for _ in range(n_steps):
        time_in_cell += flying
        flying = _push(world, chance, flying)
        flying[at_goal] = 0.0
        flying[world.airspace.blocked] = 0.0
    return time_in_cell


def _push(world: World, chance: list[FloatArray], mass: FloatArray) -> FloatArray:
    """Mass `[n_cells, goals]` after one step of the policy.

    An action leads two cells to the same place only where one of them stays put; those are added apart, so that the
    rest is a permutation and needs no slow unbuffered addition.
    """
    pushed = np.zeros_like(mass)
    here = np.arange(len(mass))
    for action, pi in enumerate(chance):
        target = world.airspace.next_cell[:, action]
        stays = target == here
        flow = pi * mass
        pushed[target[~stays]] += flow[~stays]
        pushed[here[stays]] += flow[stays]
    return pushed
