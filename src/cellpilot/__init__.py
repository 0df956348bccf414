"""cellpilot: learn and plan drone routes that stay on the cellular network."""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

_HOME = {
    "Grid": "grid",
    "World": "world",
    "Task": "task",
    "Scenario": "scenario",
    "load_scenario": "scenario",
    "find_scenario": "scenario",
    "make_map": "experiment",
    "make_task": "experiment",
    "GreedyPolicy": "policies",
    "OptimalPolicy": "policies",
    "LearnedPolicy": "policies",
    "RandomPolicy": "policies",
    "load_parameters": "policies",
    "plan_route": "plan.route",
    "InputError": "errors",
}

__all__ = ["__version__", *sorted(_HOME)]


def __getattr__(name: str) -> Any:
    # Loaded when first used: `import cellpilot` stays far below the half second that xarray and JAX would take.
    if name not in _HOME:
        raise AttributeError(f"module 'cellpilot' has no attribute {name!r}")
    return getattr(import_module(f"cellpilot.{_HOME[name]}"), name)
