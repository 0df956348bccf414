"""Thesis-2d on three kinds of map: a simulation with shadowing, a measured network, a ray-traced city; exact over all pairs.

Usage: python benchmarks/three_maps.py --log 30m.csv --traced munich.nc [--seeds 3]

The measured network is the scenario `ukm-30m` with its log (docs/results.md says where to get it); the city is what
`cellpilot map raytrace --scene munich --out munich.nc` writes. Each map has the threshold its scenario has: 3 dB, in the
measured network -3 dB. Two learners fly on each: as published (thesis-2d) and near-exact (exact-2d; ukm-30m on the log).
"""

import argparse
import time
from pathlib import Path

import numpy as np
from rich.console import Console

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, score
from cellpilot.evaluate.summary import Summary
from cellpilot.experiment import build_map, make_task
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy
from cellpilot.scenario import MapFile, MeasuredMap, Scenario, SimulatedMap, find_scenario, load_scenario
from cellpilot.world import World

console = Console(soft_wrap=True, highlight=False)


def main() -> None:
    """Train on each map, print one table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--log", type=Path, required=True, help="the measured log, 30m.csv")
    parser.add_argument("--traced", type=Path, required=True, help="the ray-traced map")
    parser.add_argument("--seeds", type=int, default=3, help="seeds 0..N-1 of each training")
    options = parser.parse_args()
    published, exact, measured = (load_scenario(find_scenario(name)) for name in ("thesis-2d", "exact-2d", "ukm-30m"))
    log_map = MeasuredMap(**(measured.map.model_dump() | {"logs": (options.log,)}))
    cases = {
        "simulation, shadowing seed 1": (published, exact, SimulatedMap(shadowing_seed=1)),
        "measured, UKM 30 m": (measured, measured, log_map),
        "ray tracing": (published, exact, MapFile(path=options.traced)),
    }
    console.print("| map | cells | below | policy | goals reached | steps below | path ratio p90 | return | score |")
    console.print("|---|---|---|---|---|---|---|---|---|")
    for name, (task_of, near_exact, settings) in cases.items():
        show(name, task_of, {"DDQN-HER": published, "FQI-HER": near_exact}, World.from_map(build_map(settings)), options.seeds)


def show(name: str, task_of: Scenario, learners: dict[str, Scenario], world: World, n_seeds: int) -> None:
    """The rows of one map."""
    task = make_task(task_of.task, world.grid)
    low = world.signal.mean_db[world.airspace.free_cells] < task.threshold_db
    rows: dict[str, list[Summary]] = {
        "greedy": [exhaustive_summary(None, world, task, GreedyPolicy(world))],
        "optimum": [exhaustive_summary(None, world, task, OptimalPolicy(world, task))],
    }
    for learner, scenario in learners.items():
        began = time.perf_counter()
        found = []
        for seed in range(n_seeds):
            trained = train_one(scenario.learner, Place(world, task), seed)
            parameters = trained.policy_parameters({"task": task.as_dict()})
            found.append(exhaustive_summary(None, world, task, LearnedPolicy(parameters, world.grid)))
        rows[f"{learner}, {n_seeds} seeds, {(time.perf_counter() - began) / n_seeds:.0f} s each"] = found
    greedy, optimal = rows["greedy"][0], rows["optimum"][0]
    for policy, figures in rows.items():
        scores = [score(each, greedy, optimal) or 0.0 for each in figures]
        cells = [spread([METRICS[what].compute(each) for each in figures], form) for what, form in COLUMNS.items()]
        n_free = len(world.airspace.free_cells)
        console.print(f"| {name} | {n_free} | {low.mean():.0%} | {policy} | {' | '.join(cells)} | {spread(scores, '.3f')} |")


COLUMNS = {"reached_share": ".2%", "low_sinr_share": ".2%", "path_ratio_p90": ".3f", "return_mean": ".3f"}


def spread(values: list[float | None], form: str) -> str:
    """Mean, and least to greatest of several values."""
    known = [value for value in values if value is not None]
    if not known:
        return "-"
    text = f"{np.mean(known):{form}}"
    return text if len(known) == 1 else f"{text} ({min(known):{form}} to {max(known):{form}})"


if __name__ == "__main__":
    main()
