"""cellpilot: learn and plan drone routes that stay on the cellular network."""

from cellpilot.lazy import loader

__version__ = "0.1.0"

# `import cellpilot` stays far below the half second that xarray and JAX would take.
_HOMES = {
    "errors": ("InputError",),
    "experiment": ("build_map", "make_task"),
    "grid": ("Grid",),
    "plan.route": ("plan_route",),
    "policies": ("GreedyPolicy", "LearnedPolicy", "OptimalPolicy", "RandomPolicy", "load_parameters"),
    "scenario": ("Scenario", "find_scenario", "load_scenario"),
    "task": ("Task",),
    "world": ("World",),
}

__all__ = ["__version__", *sorted(name for names in _HOMES.values() for name in names)]
__getattr__, __dir__ = loader(__name__, _HOMES)
