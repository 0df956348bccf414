"""What the Boltzmann policy would do if the learned values were exact: the best any learner can reach at temperature 0.1.

`python benchmarks/boltzmann_of_optimum.py` prints one row per scenario, exact over all pairs (about four minutes, mostly 3D).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from rich.console import Console

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS
from cellpilot.experiment import build_map, make_task
from cellpilot.grid import IntArray
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

SCENARIOS = ("thesis-2d", "thesis-2d-noise", "thesis-3d")
COLUMNS = ("reached_share", "low_sinr_share", "path_ratio_p50", "path_ratio_p90", "return_mean")


@dataclass(frozen=True)
class BoltzmannOfOptimum:
    """Equation 3.15 over the exact values."""

    world: World
    task: Task
    temperature: float
    name: str = "boltzmann over exact values"
    deterministic: bool = False

    def action_probabilities(self, goals: IntArray) -> NDArray[np.float32]:
        """Probabilities `[n_cells, goals, actions]`."""
        values = optimal_values(self.world, self.task, goals)
        weights = np.exp((values - values.max(-1, keepdims=True)) / self.temperature)
        return (weights / weights.sum(-1, keepdims=True)).astype(np.float32)


def main() -> None:
    """Print the rows."""
    console = Console(soft_wrap=True)
    console.print("| scenario | " + " | ".join(COLUMNS) + " |")
    for name in SCENARIOS:
        scenario = load_scenario(find_scenario(name))
        world = World.from_map(build_map(scenario.map), scenario.task.noise_std_db)
        task = make_task(scenario.task, world.grid)
        policy = BoltzmannOfOptimum(world, task, scenario.evaluation.boltzmann_temperature)
        summary = exhaustive_summary(np.random.default_rng(0), world, task, policy)
        console.print(f"| {name} | " + " | ".join(f"{METRICS[column].compute(summary):.4f}" for column in COLUMNS) + " |")


if __name__ == "__main__":
    main()
