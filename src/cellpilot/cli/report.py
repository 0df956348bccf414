"""`cellpilot report RUN`: figures and the self-contained page."""

from collections.abc import Sequence

import tyro
from pydantic import Field

from cellpilot.cli.console import err, out, share_bar
from cellpilot.cli.options import command_line, parse
from cellpilot.errors import InputError
from cellpilot.runs import evaluate_run, open_run_or_shipped, origin_warning, save_evaluation, settle, stale_parts
from cellpilot.scenario import Settings


class ReportOptions(Settings):
    """Options of `report`."""

    run: tyro.conf.Positional[str] = Field(description="run folder, or a shipped scenario with a trained policy")


def main(arguments: Sequence[str]) -> int:
    """Verb `report`; evaluates first if the run has not been, or has changed since."""
    options = parse(ReportOptions, arguments, "cellpilot report", "Write report.html and figures/ of a run.")
    found = open_run_or_shipped(options.run)
    parameters = found.parameters()
    if parameters is not None and (other := origin_warning(parameters, found.radio_map, found.task, found.seed)):
        raise InputError(f"{found.folder}: {other}: a report would show the one beside the other; restore the run's own files")
    with settle(found, command_line()) as run:
        changed = stale_parts(run)
        if changed:
            err.print(f"eval.nc was made with another {' and another '.join(changed)}: evaluating again")
        if changed is None or changed:
            with share_bar("evaluate") as progress:
                save_evaluation(run, evaluate_run(run, progress=progress))
        from cellpilot.report import write_report

        out.print(f"report: {write_report(run.folder)}")
    return 0
