"""The greedy baseline on twenty drawn maps: sampled line of sight and correlated shadowing, seeds 0 to 19.

`python benchmarks/shadowing.py` prints the share of steps below 3 dB of every seed, and mean and standard deviation
(about five minutes, mostly 3D).
"""

import statistics

import numpy as np
from rich.console import Console

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import low_sinr_share
from cellpilot.experiment import build_map, make_task
from cellpilot.policies import GreedyPolicy
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.world import World

SEEDS = range(20)


def main() -> None:
    """Print one row per scenario."""
    console = Console(soft_wrap=True)
    for name in ("thesis-2d", "thesis-2d-noise", "thesis-3d"):
        scenario = load_scenario(find_scenario(name))
        shares = []
        for seed in SEEDS:
            radio_map = build_map(scenario.map.model_copy(update={"los": "sampled", "shadowing_seed": seed}))
            world = World.from_map(radio_map, scenario.task.noise_std_db)
            task = make_task(scenario.task, world.grid)
            summary = exhaustive_summary(np.random.default_rng(0), world, task, GreedyPolicy(world))
            shares.append(100 * low_sinr_share(summary))
        row = " ".join(f"{share:.1f}" for share in shares)
        console.print(f"{name}: {statistics.mean(shares):.2f} +- {statistics.stdev(shares):.2f} %   ({row})")


if __name__ == "__main__":
    main()
