"""Figures and the self-contained page of a run."""

from pathlib import Path

from cellpilot.errors import InputError
from cellpilot.evaluate.evaluation import Progress
from cellpilot.runs import Run, evaluate_run, origin_warning, save_evaluation, settle, stale_parts
from cellpilot.service.callbacks import Warn, as_warning, untold
from cellpilot.service.sources import load_run


def report(
    run: Run | str | Path,
    *,
    command: str = "cellpilot.service.report",
    progress: Progress = untold,
    warn: Warn = as_warning,
) -> Path:
    """Write `report.html` and `figures/` of a run; its path. Evaluates first if the run has not been, or has changed since.

    `command` is what a run folder made for a shipped policy says it came from. `InputError` if the policy is not the run's.
    """
    from cellpilot.report import write_report

    found = run if isinstance(run, Run) else load_run(run)
    parameters = found.parameters()
    if parameters is not None and (other := origin_warning(parameters, found.radio_map, found.task, found.seed)):
        raise InputError(f"{found.folder}: {other}: a report would show the one beside the other; restore the run's own files")
    with settle(found, command) as settled:
        changed = stale_parts(settled)
        if changed:
            warn(f"eval.nc was made with another {' and another '.join(changed)}: evaluating again")
        if changed is None or changed:
            save_evaluation(settled, evaluate_run(settled, progress=progress))
        progress(1.0)
        return write_report(settled.folder)
