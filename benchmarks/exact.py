"""The near-exact learner on its scenarios and on deployments it was not made with: arg max over every start-goal pair.

Usage: python benchmarks/exact.py [--scenarios exact-2d ...] [--seeds 5] [--elsewhere]

Seconds include compilation (once in a process: later seeds find it done) and exclude the map and the evaluation. The
control is value iteration on the learned penalty alone: what the penalty model is worth without any network.
"""

import argparse
import sys
import time
from dataclasses import replace
from typing import Any

import numpy as np

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, reached_share, score
from cellpilot.evaluate.summary import Summary
from cellpilot.experiment import build_map, make_task
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy
from cellpilot.scenario import Scenario, find_scenario, load_scenario
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

SCENARIOS = ("exact-2d", "exact-2d-noise", "exact-3d")
ELSEWHERE: dict[str, dict[str, Any]] = {
    **{f"shadowing seed {seed}, sampled LOS": {"los": "sampled", "shadowing_seed": seed} for seed in range(1, 6)},
    **{f"downtilt {tilt} deg": {"electrical_tilt_deg": float(tilt)} for tilt in (6, 8, 10)},
    **{f"load {load}, threshold at the median": {"load": load} for load in (0.7, 0.4)},
}
"""Changes to the map of exact-2d; nothing of the learner changes with them."""


def main() -> int:
    """Train, evaluate and print a line for each scenario and seed, then for each other deployment."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--scenarios", nargs="*", default=list(SCENARIOS))
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--elsewhere", action="store_true", help="the ten other deployments, seed 0, instead")
    parser.add_argument("--model-free", action="store_true", help="the same learner without its penalty model")
    parser.add_argument("--set", nargs="*", default=[], metavar="NAME=VALUE", help="settings of the learner to change")
    arguments = parser.parse_args()
    changes = {name: float(value) if "." in value else int(value) for name, value in (s.split("=") for s in arguments.set)}
    if arguments.model_free:
        changes |= {"penalty_model": False, "look_ahead": 1}
    if arguments.elsewhere:
        scenario = load_scenario(find_scenario("exact-2d"))
        for name, change in ELSEWHERE.items():
            moved = scenario.model_copy(update={"map": scenario.map.model_copy(update=change)})
            case(name, moved, range(1), changes, at_median="median" in name)
        return 0
    for name in arguments.scenarios:
        case(name, load_scenario(find_scenario(name)), range(arguments.seeds), changes)
    return 0


def case(name: str, scenario: Scenario, seeds: range, changes: dict[str, Any], at_median: bool = False) -> None:
    """One line for the optimum, one for each seed."""
    world = World.from_map(build_map(scenario.map), scenario.task.noise_std_db)
    task = make_task(scenario.task, world.grid)
    if at_median:
        task = replace(task, threshold_db=float(np.median(world.signal.mean_db)))
    settings = scenario.learner.changed(**changes)
    greedy, optimal = (
        exhaustive_summary(None, world, task, policy) for policy in (GreedyPolicy(world), OptimalPolicy(world, task))
    )
    low = float((world.signal.mean_db < task.threshold_db).mean())
    show(f"{name}: {low:.0%} of the cells low; optimum p90 {METRICS['path_ratio_p90'].compute(optimal):.3f}")
    for seed in seeds:
        began = time.perf_counter()
        result = train_one(settings, Place(world, task), seed)
        seconds = time.perf_counter() - began
        parameters = result.policy_parameters({"task": task.as_dict()})
        learned = exhaustive_summary(None, world, task, LearnedPolicy(parameters, world.grid))
        line = (
            f"  seed {seed}: {_figures(learned, greedy, optimal)}, RMSE of Q {_error_of_q(world, task, parameters):.4f}, "
            f"{seconds:.1f} s (compilation {result.compile_s:.1f} s), {result.env_steps} transitions"
        )
        if "penalty" in parameters.tensors:
            control = OptimalPolicy(_as_learned(world, task, parameters.tensors["penalty"]), task)
            line += f"; control: {_figures(exhaustive_summary(None, world, task, control), greedy, optimal)}"
        show(line)


def show(line: str) -> None:
    """A line at once, even into a file."""
    sys.stdout.write(line + "\n")
    sys.stdout.flush()


def _figures(found: Summary, greedy: Summary, optimal: Summary) -> str:
    failed = round((1 - reached_share(found)) * found.n_flights)
    p90 = METRICS["path_ratio_p90"].compute(found)
    ratio = "-" if p90 is None else f"{p90:.3f}"
    return f"score {score(found, greedy, optimal):.4f}, reached {reached_share(found):.4%} ({failed} not), p90 {ratio}"


def _error_of_q(world: World, task: Task, parameters: Any) -> float:
    """Root-mean-square error of the action values against the exact ones, over 200 goals where there are more."""
    goals = world.airspace.free_cells[:: max(1, len(world.airspace.free_cells) // 200)]
    wrong = parameters.values(world.grid, goals) - optimal_values(world, task, goals)
    inside = (np.arange(world.grid.n_cells)[:, None] != goals[None, :]) & ~world.airspace.blocked[:, None]
    return float(np.sqrt(np.square(wrong[inside]).mean()))


def _as_learned(world: World, task: Task, penalty: np.ndarray) -> World:
    """A world whose chance of low signal is the learned penalty: mean SINR such that unit noise gives that chance."""
    from scipy.special import ndtri

    certain = np.clip(penalty.astype(np.float64), 1e-12, 1 - 1e-12)
    sinr_db = (task.threshold_db - ndtri(certain)).astype(np.float32)
    return replace(world, signal=replace(world.signal, mean_db=sinr_db, unknown=None, noise_std_db=1.0))


if __name__ == "__main__":
    sys.exit(main())
