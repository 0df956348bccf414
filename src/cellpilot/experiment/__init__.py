"""From a scenario to map, world, task, learner settings and policies: the one place where they are put together."""

from cellpilot.experiment.maps import (
    build_map,
    holdout_of,
    layout_warning,
    log_options,
    make_deployment,
    make_measured_map,
    make_simulated_map,
    make_sites,
)
from cellpilot.experiment.policies import make_policies, shipped_policy
from cellpilot.experiment.tasks import fingerprint, make_task, make_world
from cellpilot.experiment.warnings import divergence_warning, threshold_warning

__all__ = [
    "build_map",
    "divergence_warning",
    "fingerprint",
    "holdout_of",
    "layout_warning",
    "log_options",
    "make_deployment",
    "make_measured_map",
    "make_policies",
    "make_simulated_map",
    "make_sites",
    "make_task",
    "make_world",
    "shipped_policy",
    "threshold_warning",
]
