"""Evaluate policies on one world and task: exhaustively where that is possible, and on sampled flights."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from cellpilot.evaluate.exact import exhaustive_summary, goals_at_once
from cellpilot.evaluate.flights import SINR_LEVELS_DB, Departures, FlightRecords, Visits, draw_flights
from cellpilot.evaluate.instances import Instances, count_pairs, sample_pairs
from cellpilot.evaluate.metrics import COMPARED, METRICS, Returns
from cellpilot.evaluate.mobility import HandoverRule, Mobility
from cellpilot.evaluate.summary import Summary, summarise
from cellpilot.grid import IntArray, Position
from cellpilot.policies import Policy
from cellpilot.solve import LARGE_CELLS
from cellpilot.streams import Evaluating, stream
from cellpilot.task import Task
from cellpilot.world import World

N_SAMPLED = 10_000
"""Flights of a policy that are drawn (section 4.4)."""

MAX_EXHAUSTIVE_PAIRS = 5_000_000
GOALS_TIMES_CELLS = 9_000_000
"""On more cells than `solve.LARGE_CELLS`, sampled flights lead to fewer goals: 100 on 300 x 300 cells, 10 on 1,000 x 1,000."""
A3 = HandoverRule()

Progress = Callable[[float], None]


@dataclass(frozen=True)
class Evaluation:
    """Metrics by policy name, and the sampled flights behind the distributions."""

    exhaustive: bool
    n_pairs: int
    unreachable_pairs: int
    policies: dict[str, dict[str, Any]]  # exhaustive if `exhaustive`, else the sampled ones
    sampled: dict[str, dict[str, Any]]
    flights: dict[str, FlightRecords] = field(repr=False)
    sinr_histogram: dict[str, np.ndarray] = field(repr=False)  # sampled, [levels + 1]
    made_from: dict[str, str] = field(default_factory=dict)  # digests of what it depends on, by name


def evaluate_policies(
    world: World,
    task: Task,
    policies: Sequence[Policy],
    *,
    seed: int,
    n_sampled: int = N_SAMPLED,
    start: Position | None = None,
    goal: Position | None = None,
    max_exhaustive_pairs: int = MAX_EXHAUSTIVE_PAIRS,
    rule: HandoverRule = A3,
    progress: Progress = lambda share: None,
) -> Evaluation:
    """Fly every policy on the same instances, each with a stream of draws of the same seed.

    Handovers and outages in seconds come from the sampled flights, in the exact figures too; they follow `rule`.
    Score and regret need policies named `greedy` and `optimal` among them. `progress` is told the share done (0..1).
    """
    n_pairs, unreachable = count_pairs(world, start, goal)
    exhaustive = n_pairs < max_exhaustive_pairs
    n_goals = None if exhaustive else most_goals(world)
    instances = sample_pairs(stream(seed, Evaluating.INSTANCES), world, n_sampled, start, goal, n_goals)
    exact, sampled, flights, histograms = {}, {}, {}, {}
    for i, policy in enumerate(policies):
        done = lambda share, i=i: progress((i + share) / len(policies))
        tell = done if not exhaustive else lambda share: None
        records, visits = sampled_flights(stream(seed, Evaluating.FLIGHTS), world, task, policy, instances, rule, tell)
        flights[policy.name], histograms[policy.name] = records, visits.sinr_histogram
        sampled[policy.name] = _metrics(summarise(records, visits, world, task, expected=False)) | _intervals(records)
        if exhaustive:
            rng = stream(seed, Evaluating.EXHAUSTIVE)
            summary = exhaustive_summary(rng, world, task, policy, start, goal, done)
            exact[policy.name] = _metrics(replace(summary, mobility=visits.mobility)) | _intervals(None)
        done(1.0)
    for table in (exact, sampled):
        add_compared(table)
    return Evaluation(exhaustive, n_pairs, unreachable, exact or sampled, sampled, flights, histograms)


def most_goals(world: World) -> int | None:
    """To how many goals sampled flights lead: every goal is one more solution for all cells. None = any number."""
    n_cells = world.grid.n_cells
    return None if n_cells <= LARGE_CELLS else max(10, GOALS_TIMES_CELLS // n_cells)


def sampled_flights(
    rng: np.random.Generator,
    world: World,
    task: Task,
    policy: Policy,
    instances: Instances,
    rule: HandoverRule | None = None,
    progress: Progress = lambda share: None,
) -> tuple[FlightRecords, Visits]:
    """One drawn flight per instance, in the order of the instances."""
    at_once = goals_at_once(world)
    goals, column = np.unique(instances.goal, return_inverse=True)
    order = np.argsort(column, kind="stable")
    parts: list[FlightRecords] = []
    total = Visits(np.zeros(world.grid.n_cells), np.zeros(len(SINR_LEVELS_DB) + 1), Mobility())
    for i in range(0, len(goals), at_once):
        block: IntArray = goals[i : i + at_once]
        rows = order[(column[order] >= i) & (column[order] < i + at_once)]
        departures = Departures(policy.action_probabilities(block), block, instances.start[rows], column[rows] - i)
        records, visits = draw_flights(rng, world, task, departures, rule)
        parts.append(records)
        total = total + visits
        progress(min(1.0, (i + at_once) / len(goals)))
    back = np.argsort(order, kind="stable")
    joined = FlightRecords.concatenate(parts)
    in_order = FlightRecords(*(getattr(joined, name)[back] for name in joined.__dataclass_fields__))
    return in_order, total


def add_compared(table: dict[str, dict[str, Any]]) -> None:
    """Write the metrics that compare a policy with the baseline and the optimum of a table into each of its rows."""
    optimal, greedy = (table[name]["return_mean"] if name in table else None for name in ("optimal", "greedy"))
    for row in table.values():
        returns = Returns(row["return_mean"], greedy, optimal)
        row |= {name: metric.compute(returns) for name, metric in COMPARED.items()}


def _metrics(summary: Summary) -> dict[str, Any]:
    return {name: metric.compute(summary) for name, metric in METRICS.items()}


def _intervals(records: FlightRecords | None) -> dict[str, Any]:
    """The 95 % intervals by name, of sampled flights; None for exact figures."""
    intervals = [metric.interval for metric in METRICS.values() if metric.interval is not None]
    return {interval.name: None if records is None else interval.compute(records) for interval in intervals}
