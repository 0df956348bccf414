"""`cellpilot report RUN`: figures and the self-contained page."""

from collections.abc import Sequence

import tyro
from pydantic import Field

from cellpilot.cli.console import err, out, share_bar
from cellpilot.cli.options import command_line, parse
from cellpilot.scenario import Settings
from cellpilot.service import report


class ReportOptions(Settings):
    """Options of `report`."""

    run: tyro.conf.Positional[str] = Field(description="run folder, or a shipped scenario with a trained policy")


def main(arguments: Sequence[str]) -> int:
    """Verb `report`; evaluates first if the run has not been, or has changed since."""
    options = parse(ReportOptions, arguments, "cellpilot report", "Write report.html and figures/ of a run.")
    with share_bar("report") as progress:
        path = report(options.run, command=command_line(), progress=progress, warn=err.print)
    out.print(f"report: {path}")
    return 0
