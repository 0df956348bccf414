"""Many flights in lock-step, in NumPy: one draw of noise and actions each, and the expectation beside it."""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from functools import reduce
from operator import add
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from cellpilot.evaluate.mobility import HandoverRule, Mobility, Ride
from cellpilot.grid import IntArray
from cellpilot.task import Task, Transition
from cellpilot.world import World

FLIGHTS_WITH_OWN_MAP = 20_000_000
"""At most this many cell values are drawn at a time where each flight has its own draw of an uncertain map."""


@dataclass(frozen=True)
class FlightRecords:
    """One row per flight, `[flights]`."""

    reached: NDArray[np.bool_]
    n_steps: IntArray
    shortest_steps: IntArray
    drawn_return: NDArray[np.float64]  # rewards for the noise as drawn
    expected_return: NDArray[np.float64]  # rewards in expectation over noise, along the cells flown
    low_steps: IntArray  # steps measured below the threshold
    expected_low_steps: NDArray[np.float64]
    longest_outage_steps: IntArray  # longest run of consecutive steps measured below the threshold

    @classmethod
    def concatenate(cls, parts: "list[FlightRecords]") -> "FlightRecords":
        """All rows of all parts."""
        return cls(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(cls)))


@dataclass(frozen=True)
class Visits:
    """Where the steps of all flights went."""

    by_cell: NDArray[np.float64]  # [n_cells] steps that entered (or stayed in) the cell
    sinr_histogram: NDArray[np.float64]  # [levels + 1] measured SINR between the levels of `SINR_LEVELS_DB`
    mobility: Mobility  # of no flight, if there was no handover rule

    def __add__(self, other: "Visits") -> "Visits":
        return Visits(self.by_cell + other.by_cell, self.sinr_histogram + other.sinr_histogram, self.mobility + other.mobility)


SINR_LEVELS_DB = np.arange(-30.0, 40.05, 0.1).round(1)
"""Levels at which the distribution of measured SINR is kept [dB]; they contain the bounds of every RF class."""


class Departures(NamedTuple):
    """Flights about to begin, and the policy that flies them."""

    probabilities: NDArray[np.float32]  # [n_cells, goals, actions]
    goals: IntArray  # [goals]
    start: IntArray  # [flights]
    goal_column: IntArray  # [flights] of `goals` and `probabilities`

    def blocks(self, world: World) -> "list[Departures]":
        """Those that are drawn together: all of them, unless each flight has its own draw of an uncertain map."""
        n = max(1, len(self.start))
        rows = n if world.signal.unknown is None else max(1, FLIGHTS_WITH_OWN_MAP // world.grid.n_cells)
        part = lambda i: self._replace(start=self.start[i : i + rows], goal_column=self.goal_column[i : i + rows])
        return [part(i) for i in range(0, n, rows)]


class Step(NamedTuple):
    """One step of those flights that are still in the air, fields `[n]`."""

    flight: IntArray  # their numbers
    transition: Transition
    goal: IntArray
    reached: NDArray[np.bool_]


def draw_flights(
    rng: np.random.Generator, world: World, task: Task, departures: Departures, rule: HandoverRule | None = None
) -> tuple[FlightRecords, Visits]:
    """Fly from each start to its goal, one draw of noise, map and actions each.

    With a `rule` the handovers and the time of outages are followed as well.
    """
    parts = [_recorded(rng, world, task, block, rule) for block in departures.blocks(world)]
    return FlightRecords.concatenate([records for records, _ in parts]), reduce(add, [visits for _, visits in parts])


def longest_outages(rng: np.random.Generator, world: World, task: Task, departures: Departures) -> IntArray:
    """Longest run of steps below the threshold `[flights]` of the flights that `draw_flights` draws."""
    parts = []
    for block in departures.blocks(world):
        outage, longest = (np.zeros(len(block.start), np.int32) for _ in range(2))
        for step in _steps(rng, world, task, block):
            _count_outage(outage, longest, step.flight, step.transition.sinr_db < task.threshold_db)
        parts.append(longest)
    return np.concatenate(parts)


def _count_outage(outage: IntArray, longest: IntArray, flight: IntArray, low: NDArray[np.bool_]) -> None:
    """Write the present and the longest outage of the numbered flights after one more step."""
    outage[flight] = np.where(low, outage[flight] + 1, 0)
    longest[flight] = np.maximum(longest[flight], outage[flight])


def _steps(rng: np.random.Generator, world: World, task: Task, departures: Departures) -> Iterator[Step]:
    """All flights in lock-step, until each has ended or the cap on steps is reached."""
    probabilities, goals, start, goal_column = departures
    n, signal, airspace = len(start), world.signal, world.airspace
    own_map = None if signal.unknown is None else signal.unknown.draw(rng.standard_normal((n, world.grid.n_cells), np.float32))
    certain = bool((probabilities.max(-1) == 1).all())
    choice = probabilities.argmax(-1).astype(np.int8) if certain else np.cumsum(probabilities, -1)[..., :-1]
    flight, cell, column = np.arange(n), start.astype(np.int32), goal_column
    for _ in range(task.max_steps):
        if not flight.size:
            return
        row = choice[cell, column]
        action = row if certain else (rng.random(len(flight))[:, None] >= row).sum(-1)
        next_cell = airspace.next_cell[cell, action]
        error_db = None if own_map is None else own_map[flight, next_cell]
        noise = rng.standard_normal(len(flight), np.float32) if signal.noise_std_db else None
        sinr_db = signal.measure(next_cell, error_db, noise)
        transition = Transition(cell, action, next_cell, sinr_db, airspace.event[cell, action])
        reached, terminated = task.end(next_cell, transition.event, goals[column])
        yield Step(flight, transition, goals[column], reached)
        going = ~terminated
        flight, cell, column = flight[going], next_cell[going], column[going]


def _recorded(
    rng: np.random.Generator, world: World, task: Task, departures: Departures, rule: HandoverRule | None
) -> tuple[FlightRecords, Visits]:
    start = departures.start
    ride = None if rule is None else Ride(world, rule, start)
    low_probability = world.outage_probability(task.threshold_db)
    records = _empty_records(len(start))
    records.shortest_steps[:] = world.airspace.shortest_steps(departures.goals)[start, departures.goal_column]
    by_cell, histogram = np.zeros(world.grid.n_cells), np.zeros(len(SINR_LEVELS_DB) + 1)
    outage = np.zeros(len(start), np.int32)
    for flight, transition, goal, reached in _steps(rng, world, task, departures):
        cell, action, next_cell, sinr_db, _ = transition
        low = sinr_db < task.threshold_db
        records.n_steps[flight] += 1
        records.drawn_return[flight] += task.outcome(transition, goal).reward
        records.expected_return[flight] += task.expected_outcome(world, cell, action, goal).reward
        records.low_steps[flight] += low
        records.expected_low_steps[flight] += low_probability[next_cell]
        _count_outage(outage, records.longest_outage_steps, flight, low)
        if ride is not None:
            ride.step(flight, cell, next_cell, low)
        records.reached[flight[reached]] = True
        by_cell += np.bincount(next_cell, minlength=by_cell.size)
        known_db = sinr_db[~np.isnan(sinr_db)]  # a flight may end in a blocked cell of unknown SINR
        histogram += np.bincount(np.searchsorted(SINR_LEVELS_DB, known_db, side="right"), minlength=histogram.size)
    return records, Visits(by_cell, histogram, Mobility() if ride is None else ride.mobility)


def _empty_records(n: int) -> FlightRecords:
    def counts() -> IntArray:
        return np.zeros(n, np.int32)

    return FlightRecords(np.zeros(n, bool), counts(), counts(), np.zeros(n), np.zeros(n), counts(), np.zeros(n), counts())
