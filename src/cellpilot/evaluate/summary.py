"""`Summary`: the sums from which every metric of a policy is computed, exact, drawn or by recursion alike."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from cellpilot.evaluate.flights import SINR_LEVELS_DB, FlightRecords, Visits
from cellpilot.evaluate.mobility import Mobility
from cellpilot.task import Task
from cellpilot.world import World


@dataclass
class Summary:
    """Sums over flights, or their expectations; `+` joins two sets of flights of one policy on one world."""

    n_flights: float
    arrivals: NDArray[np.float64]  # [steps, shortest] flights that reached the goal in so many steps
    n_steps: float
    low_steps: float
    return_sum: float
    steps_by_height: NDArray[np.float64]  # [heights]
    sinr_histogram: NDArray[np.float64]  # [levels + 1]
    outages: NDArray[np.float64]  # [steps] flights by their longest outage
    mobility: Mobility = field(default_factory=Mobility)  # of drawn flights; of none where they were not followed

    def __add__(self, other: "Summary") -> "Summary":
        return Summary(*(getattr(self, name) + getattr(other, name) for name in self.__dataclass_fields__))


def longest_shortest_path(world: World, task: Task) -> int:
    """An upper bound of the shortest path of any flight that arrives within the cap, for the size of tables."""
    return min(world.grid.n_cells if world.airspace.blocked.any() else sum(world.grid.sides), task.max_steps)


def summarise(records: FlightRecords, visits: Visits, world: World, task: Task, expected: bool) -> Summary:
    """Sums of flown records: expectations over noise if `expected`, else the draws."""
    shape = (task.max_steps + 1, longest_shortest_path(world, task) + 1)
    place = np.ravel_multi_index((records.n_steps[records.reached], records.shortest_steps[records.reached]), shape)
    arrivals = np.bincount(place, minlength=shape[0] * shape[1]).reshape(shape).astype(float)
    return Summary(
        n_flights=float(len(records.reached)),
        arrivals=arrivals,
        n_steps=float(records.n_steps.sum()),
        low_steps=float((records.expected_low_steps if expected else records.low_steps).sum()),
        return_sum=float((records.expected_return if expected else records.drawn_return).sum()),
        steps_by_height=steps_by_height(visits.by_cell, world),
        sinr_histogram=expected_sinr_histogram(visits.by_cell, world) if expected else visits.sinr_histogram,
        outages=np.bincount(records.longest_outage_steps, minlength=task.max_steps + 1).astype(float),
        mobility=visits.mobility,
    )


def steps_by_height(by_cell: NDArray[np.float64], world: World) -> NDArray[np.float64]:
    """Steps at each height `[heights]`."""
    return by_cell.reshape(len(world.grid.z_m), -1).sum(1)


def expected_sinr_histogram(by_cell: NDArray[np.float64], world: World) -> NDArray[np.float64]:
    """Expected number of measurements between the levels `[levels + 1]` when the cells are entered so often."""
    visited = np.flatnonzero((by_cell > 0) & ~np.isnan(world.signal.mean_db))  # a flight may end in a blocked cell
    mean_db = world.signal.mean_db[visited].astype(np.float64)[:, None]
    spread_db = np.hypot(world.signal.noise_std_db, world.signal.std_db[visited].astype(np.float64))[:, None]
    certain = spread_db == 0
    margin_db = SINR_LEVELS_DB[None, :] - mean_db
    below = np.where(certain, margin_db > 0, ndtr(margin_db / np.where(certain, 1.0, spread_db)))
    cumulative = by_cell[visited] @ below
    return np.diff(np.concatenate([[0.0], cumulative, [by_cell[visited].sum()]]))
