"""The switches of DDQN-HER that the thesis does not have, each alone and all together, on the published two-dimensional run.

Usage: python benchmarks/switches.py [--seeds 5] [--episodes 30000] [--variants NAME ...]

All seeds of a variant are trained in one program. Score, share reached and path ratio are those of arg max over every
start-goal pair, RMSE that of the learned action values against the exact ones; mean and range over the seeds.
"""

import argparse
import platform
import sys
import time
from datetime import UTC, datetime
from typing import Any

import jax
import numpy as np
from exact import _error_of_q, show

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, score
from cellpilot.experiment import build_map, make_task
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHERVariants
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_many
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.task import Task
from cellpilot.world import World

SWITCHES: dict[str, dict[str, Any]] = {
    "dueling": {"architecture": "dueling"},
    "n_steps 3": {"n_steps": 3},
    "prioritised": {"prioritised": True},
    "networks 2": {"networks": 2},
}
ALL = {name: value for change in SWITCHES.values() for name, value in change.items()}
VARIANTS: dict[str, dict[str, Any]] = {"as published": {}, **SWITCHES, "all four": ALL}
COLUMNS = ("score", "reached [%]", "p90", "RMSE of Q", "Boltzmann 0.1: reached [%]", "p90")


def main() -> int:
    """Train and print a line of the table for each variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--episodes", type=int, default=30_000)
    parser.add_argument("--variants", nargs="*", default=list(VARIANTS), choices=VARIANTS)
    options = parser.parse_args()
    scenario = load_scenario(find_scenario("thesis-2d"))
    world = World.from_map(build_map(scenario.map), scenario.task.noise_std_db)
    task = make_task(scenario.task, world.grid)
    show(f"{options.episodes} episodes, seeds 0-{options.seeds - 1}, {platform.machine()}, {datetime.now(UTC):%Y-%m-%d}")
    show("| variant | " + " | ".join(COLUMNS) + " | seconds (relative) |")
    show("|---" * (2 + len(COLUMNS)) + "|")
    published_s, published = None, scenario.learner.model_dump(exclude={"algorithm"})
    for name in options.variants:
        learner = DDQNHERVariants(**published | VARIANTS[name] | {"episodes": options.episodes})
        jax.clear_caches()
        began = time.perf_counter()
        results = train_many(learner, Place(world, task), range(options.seeds))
        seconds = time.perf_counter() - began
        published_s = seconds if name == "as published" else published_s
        about = {"task": task.as_dict()}
        rows = [figures_of(world, task, result.policy_parameters(about)) for result in results]
        show(f"  {name}, seed by seed: " + "; ".join(" ".join(f"{value:.4g}" for value in row) for row in rows))
        cells = [f"{np.mean(column):.4g} ({min(column):.4g} to {max(column):.4g})" for column in zip(*rows, strict=True)]
        relative = "" if published_s is None else f" ({seconds / published_s:.2f})"
        show(f"| {name} | " + " | ".join(cells) + f" | {seconds:.0f}{relative} |")
    return 0


def figures_of(world: World, task: Task, parameters: Any) -> list[float]:
    """One seed's figures in the order of `COLUMNS`."""
    greedy, optimal = (
        exhaustive_summary(None, world, task, policy) for policy in (GreedyPolicy(world), OptimalPolicy(world, task))
    )
    best = exhaustive_summary(None, world, task, LearnedPolicy(parameters, world.grid))
    boltzmann = LearnedPolicy(parameters, world.grid, 0.1)
    soft = exhaustive_summary(None, world, task, boltzmann)
    return [
        score(best, greedy, optimal) or 0.0,
        100 * METRICS["reached_share"].compute(best),
        METRICS["path_ratio_p90"].compute(best) or np.inf,
        _error_of_q(world, task, parameters),
        100 * METRICS["reached_share"].compute(soft),
        METRICS["path_ratio_p90"].compute(soft) or np.inf,
    ]


if __name__ == "__main__":
    sys.exit(main())
