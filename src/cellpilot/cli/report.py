"""`cellpilot report RUN`: figures and the self-contained page."""

from collections.abc import Sequence

import tyro
from pydantic import Field

from cellpilot.cli.console import out, share_bar
from cellpilot.cli.options import command_line, parse
from cellpilot.runs import evaluate_run, open_run_or_shipped, save_evaluation
from cellpilot.scenario import Settings


class ReportOptions(Settings):
    """Options of `report`."""

    run: tyro.conf.Positional[str] = Field(description="run folder, or a shipped scenario with a trained policy")


def main(arguments: Sequence[str]) -> int:
    """Verb `report`; evaluates first if the run has not been."""
    options = parse(ReportOptions, arguments, "cellpilot report", "Write report.html and figures/ of a run.")
    run = open_run_or_shipped(options.run, command_line())
    if not (run.folder / "eval.nc").is_file():
        with share_bar("evaluate") as progress:
            save_evaluation(run, evaluate_run(run, progress=progress))
    from cellpilot.report import write_report

    out.print(f"report: {write_report(run.folder)}")
    return 0
