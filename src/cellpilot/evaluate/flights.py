"""Many flights in lock-step, in NumPy: one draw of noise and actions each, and the expectation beside it."""

from dataclasses import dataclass, fields
from functools import reduce
from operator import add

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


def fly(
    rng: np.random.Generator,
    world: World,
    task: Task,
    probabilities: NDArray[np.float32],
    goals: IntArray,
    start: IntArray,
    goal_column: IntArray,
    rule: HandoverRule | None = None,
) -> tuple[FlightRecords, Visits]:
    """Fly from each `start` to `goals[goal_column]` under `probabilities [n_cells, goals, actions]`.

    With a `rule` the handovers and the time of outages are followed as well.
    """
    if world.signal.unknown is not None:
        rows = max(1, FLIGHTS_WITH_OWN_MAP // world.grid.n_cells)
        parts = [
            _fly(rng, world, task, probabilities, goals, start[i : i + rows], goal_column[i : i + rows], rule)
            for i in range(0, len(start), rows)
        ]
        visits = reduce(add, [visits for _, visits in parts])
        return FlightRecords.concatenate([records for records, _ in parts]), visits
    return _fly(rng, world, task, probabilities, goals, start, goal_column, rule)


def _fly(
    rng: np.random.Generator,
    world: World,
    task: Task,
    probabilities: NDArray[np.float32],
    goals: IntArray,
    start: IntArray,
    goal_column: IntArray,
    rule: HandoverRule | None,
) -> tuple[FlightRecords, Visits]:
    n = len(start)
    ride = None if rule is None else Ride(world, rule, start)
    signal, airspace = world.signal, world.airspace
    low_probability = world.outage_probability(task.threshold_db)
    own_map = None if signal.unknown is None else signal.unknown.draw(rng.standard_normal((n, world.grid.n_cells), np.float32))
    certain = bool((probabilities.max(-1) == 1).all())
    choice = probabilities.argmax(-1).astype(np.int8) if certain else np.cumsum(probabilities, -1)[..., :-1]
    records = _empty_records(n)
    records.shortest_steps[:] = airspace.shortest_steps(goals)[start, goal_column]
    by_cell, histogram = np.zeros(world.grid.n_cells), np.zeros(len(SINR_LEVELS_DB) + 1)
    flight, cell, column = np.arange(n), start.astype(np.int32), goal_column
    outage = np.zeros(n, np.int32)
    for _ in range(task.max_steps):
        if not flight.size:
            break
        row = choice[cell, column]
        action = row if certain else (rng.random(len(flight))[:, None] >= row).sum(-1)
        next_cell = airspace.next_cell[cell, action]
        error_db = None if own_map is None else own_map[flight, next_cell]
        noise = rng.standard_normal(len(flight), np.float32) if signal.noise_std_db else None
        sinr_db = signal.measure(next_cell, error_db, noise)
        transition = Transition(cell, action, next_cell, sinr_db, airspace.event[cell, action])
        reward, reached, terminated = task.outcome(transition, goals[column])
        expected = task.expected_outcome(world, cell, action, goals[column]).reward
        low = sinr_db < task.threshold_db
        records.n_steps[flight] += 1
        records.drawn_return[flight] += reward
        records.expected_return[flight] += expected
        records.low_steps[flight] += low
        records.expected_low_steps[flight] += low_probability[next_cell]
        outage[flight] = np.where(low, outage[flight] + 1, 0)
        records.longest_outage_steps[flight] = np.maximum(records.longest_outage_steps[flight], outage[flight])
        if ride is not None:
            ride.step(flight, cell, next_cell, low)
        records.reached[flight[reached]] = True
        by_cell += np.bincount(next_cell, minlength=by_cell.size)
        known_db = sinr_db[~np.isnan(sinr_db)]  # a flight may end in a blocked cell of unknown SINR
        histogram += np.bincount(np.searchsorted(SINR_LEVELS_DB, known_db, side="right"), minlength=histogram.size)
        going = ~terminated
        flight, cell, column = flight[going], next_cell[going], column[going]
    return records, Visits(by_cell, histogram, Mobility() if ride is None else ride.mobility)


def _empty_records(n: int) -> FlightRecords:
    def counts() -> IntArray:
        return np.zeros(n, np.int32)

    return FlightRecords(np.zeros(n, bool), counts(), counts(), np.zeros(n), np.zeros(n), counts(), np.zeros(n), counts())
