"""The policies that are compared on a world, and the trained one that ships beside a scenario."""

from collections.abc import Sequence
from pathlib import Path

from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, Policy, PolicyParameters
from cellpilot.task import Task
from cellpilot.world import World


def make_policies(world: World, task: Task, temperature: float, parameters: PolicyParameters | None) -> Sequence[Policy]:
    """Baseline, optima and, where there are parameters, the learned policy twice: arg max and Boltzmann."""
    policies: list[Policy] = [GreedyPolicy(world), OptimalPolicy(world, task), OptimalPolicy.undiscounted(world, task)]
    if parameters is not None:
        parameters.check_airspace(world.airspace)
        policies += [LearnedPolicy(parameters, world.grid), LearnedPolicy(parameters, world.grid, temperature)]
    return policies


def shipped_policy(scenario_file: Path) -> PolicyParameters | None:
    """The trained policy that ships beside a scenario file, if there is one."""
    from cellpilot.policies import load_parameters

    path = scenario_file.with_suffix(".safetensors")
    return load_parameters(path) if path.is_file() else None
