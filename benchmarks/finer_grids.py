"""What a finer grid needs: FQI-HER with more rounds and longer looks ahead, and the map learner after some flights.

Usage: python benchmarks/finer_grids.py [--side 40] [--rounds 200 1000] [--look-ahead 8 16 32] [--flights 30 60 100] [--seeds 1]

The map and task of `scaling.py`, exact over every start and the goals drawn there. `--rounds 0` or `--flights 0` leaves one
of the two out.
"""

import argparse
import time

import numpy as np
from rich.console import Console
from scaling import GOALS, LEARNERS, Case, make_case

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, reached_share, score
from cellpilot.learn.algorithms.map_learner import learn_map
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy

console = Console(soft_wrap=True, highlight=False)


def main() -> None:
    """Train, fly, print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=40, help="cells along each side of 400 m")
    parser.add_argument("--rounds", type=int, nargs="+", default=[200, 1000], help="rounds of FQI-HER")
    parser.add_argument("--look-ahead", type=int, nargs="+", default=[8, 16, 32], help="moves its policy looks ahead")
    parser.add_argument("--flights", type=int, nargs="+", default=[30, 60, 100], help="flights of the map learner, increasing")
    parser.add_argument("--seeds", type=int, default=1, help="seeds 0..N-1")
    options = parser.parse_args()
    case = make_case(LEARNERS["fqi-her"], options.side)
    goals = np.sort(np.random.default_rng(0).choice(case.world.airspace.free_cells, GOALS, replace=False))
    for seed in range(options.seeds):
        for rounds in filter(None, options.rounds):
            began = time.perf_counter()
            trained = train_one(case.settings.changed(rounds=rounds), case.place, seed)
            seconds = time.perf_counter() - began
            parameters = trained.policy_parameters({"task": case.task.as_dict()})
            for moves in options.look_ahead:
                parameters.about["look_ahead"] = moves
                what = f"FQI-HER, {rounds} rounds, looks {moves} ahead, {trained.env_steps:,} steps"
                show(case, goals, LearnedPolicy(parameters, case.world.grid), f"seed {seed}: {what}, {seconds:.0f} s")
        began = time.perf_counter()
        if any(options.flights):
            for learner in learn_map(case.world, case.task, MapLearning(), seed, options.flights):
                what = f"map learner, {learner.n_flights} flights, {time.perf_counter() - began:.0f} s"
                show(case, goals, learner.policy(), f"seed {seed}: {what}")


def show(case: Case, goals: np.ndarray, policy: Policy, what: str) -> None:
    """One line of figures."""
    others = (GreedyPolicy(case.world), OptimalPolicy(case.world, case.task))
    greedy, optimal, found = (exhaustive_summary(None, case.world, case.task, p, goals=goals) for p in (*others, policy))
    p90, best_p90 = (METRICS["path_ratio_p90"].compute(each) for each in (found, optimal))
    console.print(
        f"{what}: score {score(found, greedy, optimal):.3f}, reached {reached_share(found):.2%}, p90 {p90:.3f} ({best_p90:.3f})"
    )


if __name__ == "__main__":
    main()
