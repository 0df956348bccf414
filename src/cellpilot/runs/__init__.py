"""Run folders: everything of one run, each file made on its own and written whole.

`scenario.toml map.nc run.json state.safetensors train.nc policy.safetensors eval.nc report.html figures/`
"""

from cellpilot.runs.evaluation import evaluate_run, finite, load_evaluation, made_from, payload, save_evaluation, stale_parts
from cellpilot.runs.files import FIGURE_STEMS, RunFacts, is_occupied, read_facts
from cellpilot.runs.folder import Run, create_run, open_or_create_run, open_run, open_run_or_shipped, settle
from cellpilot.runs.origin import map_digest, origin_warning, policy_digest
from cellpilot.runs.training import train_run, train_runs

__all__ = [
    "FIGURE_STEMS",
    "Run",
    "RunFacts",
    "create_run",
    "evaluate_run",
    "finite",
    "is_occupied",
    "load_evaluation",
    "made_from",
    "map_digest",
    "open_or_create_run",
    "open_run",
    "open_run_or_shipped",
    "origin_warning",
    "payload",
    "policy_digest",
    "read_facts",
    "save_evaluation",
    "settle",
    "stale_parts",
    "train_run",
    "train_runs",
]
