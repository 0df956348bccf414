"""Exact figures: every start-goal pair, in expectation over noise and over the actions of a stochastic policy.

A deterministic policy is flown from every start. A stochastic one needs two recursions per goal up to the cap on
steps: backwards for the chance to arrive after exactly t steps, forwards for how often each cell is entered.
The longest outage depends on the order of draws; it alone comes from drawn flights: one per pair for a deterministic
policy, evenly spread over the pairs for a stochastic one.
"""

import numpy as np
from numpy.typing import NDArray

from cellpilot.evaluate.flights import fly
from cellpilot.evaluate.instances import all_pairs
from cellpilot.evaluate.summary import (
    Summary,
    expected_sinr_histogram,
    longest_shortest_path,
    steps_by_height,
    summarise,
)
from cellpilot.grid import IntArray, Position
from cellpilot.policies import Policy
from cellpilot.task import Task
from cellpilot.world import World

DRAWN_FLIGHTS = 250_000
"""At most about so many flights are drawn for the longest outage of a stochastic policy."""

NEGLIGIBLE = 1e-13
"""A recursion ends when no start has more than this chance of still being in the air."""


def exact_summary(
    rng: np.random.Generator,
    world: World,
    task: Task,
    policy: Policy,
    goals: IntArray,
    start: Position | None = None,
    draw_every: int = 1,
) -> Summary:
    """Summary over every start and these goals.

    `rng` is used for the longest outage alone; for a stochastic policy it comes from every `draw_every`-th pair.
    """
    probabilities = policy.action_probabilities(goals)
    starts, goal = all_pairs(world, goals, start)
    order = np.argsort(goals)
    column = order[np.searchsorted(goals, goal, sorter=order)]
    drawn = slice(None, None, 1 if policy.deterministic else draw_every)
    records, visits = fly(rng, world, task, probabilities, goals, starts[drawn], column[drawn])
    flown = summarise(records, visits, world, task, expected=True)
    return flown if policy.deterministic else _recursion(world, task, probabilities, goals, starts, column, flown.outages)


def _recursion(
    world: World,
    task: Task,
    probabilities: NDArray[np.float32],
    goals: IntArray,
    starts: IntArray,
    column: IntArray,
    outages: NDArray[np.float64],
) -> Summary:
    exact = probabilities.astype(np.float64)
    exact /= exact.sum(-1, keepdims=True)  # float32 rows sum to 1 only within 1e-7, which 400 steps would compound
    chance = [np.ascontiguousarray(exact[..., a]) for a in range(world.airspace.n_actions)]
    departures = np.zeros((world.grid.n_cells, len(goals)))
    departures[starts, column] = 1.0
    arrivals, in_the_air = _arrivals(world, task, chance, goals, departures)
    expected_return, entered, n_steps = _occupancy(world, task, chance, goals, departures, in_the_air)
    low = world.outage_probability(task.threshold_db)
    return Summary(
        n_flights=float(len(starts)),
        arrivals=arrivals,
        n_steps=n_steps,
        low_steps=float(low @ entered),
        return_sum=expected_return,
        steps_by_height=steps_by_height(entered, world),
        sinr_histogram=expected_sinr_histogram(entered, world),
        outages=outages,
    )


def _arrivals(
    world: World, task: Task, chance: list[NDArray[np.float64]], goals: IntArray, departures: NDArray[np.float64]
) -> tuple[NDArray[np.float64], int]:
    """Arrivals `[steps, shortest]`, and the number of steps after which nobody is in the air any more.

    f_t(s) = sum_a pi(a|s) f_{t-1}(s'), where f_0 is 1 at the goal and 0 elsewhere, and f_t = 0 for t > 0 where flights end.
    Who has ended elsewhere counts as in the air here, for ever.
    """
    at_goal = (goals, np.arange(len(goals)))
    width = longest_shortest_path(world, task) + 1
    shortest = np.where(departures > 0, np.minimum(world.airspace.shortest_steps(goals), width - 1), 0).astype(np.intp)
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


def _occupancy(
    world: World,
    task: Task,
    chance: list[NDArray[np.float64]],
    goals: IntArray,
    departures: NDArray[np.float64],
    n_steps: int,
) -> tuple[float, NDArray[np.float64], float]:
    """Expected return over all flights, how often each cell is entered `[n_cells]`, and all steps flown.

    Moves m_{t+1}(s') = sum over (s, a) that lead to s' of m_t(s) pi(a|s); mass where flights end leaves.
    """
    at_goal = (goals, np.arange(len(goals)))
    time_in_cell = np.zeros_like(departures)
    flying = departures.copy()
    for _ in range(n_steps):
        time_in_cell += flying
        flying = _push(world, chance, flying)
        flying[at_goal] = 0.0
        flying[world.airspace.blocked] = 0.0
    cell = np.arange(world.grid.n_cells)[:, None]
    total = 0.0
    for action, pi in enumerate(chance):
        reward = task.expected_outcome(world, cell, action, goals[None, :]).reward
        total += float((time_in_cell * pi * reward).sum())
    entered = _push(world, chance, time_in_cell).sum(1)
    return total, entered, float(time_in_cell.sum())


def _push(world: World, chance: list[NDArray[np.float64]], mass: NDArray[np.float64]) -> NDArray[np.float64]:
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
