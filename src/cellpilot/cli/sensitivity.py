"""`cellpilot sensitivity SCENARIO`: reward parameters against signal and detour (section 4.2.2)."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import err, out, share_bar
from cellpilot.cli.options import ScenarioOptions, command_line, parse_scenario
from cellpilot.evaluate import METRICS
from cellpilot.runs import open_or_create_run
from cellpilot.storage import hold
from cellpilot.studies.sensitivity import sensitivity


class SensitivityOptions(ScenarioOptions):
    """Options of `sensitivity`."""

    learned: bool = Field(False, description="train the learner at each point too, not only the exact optimum")
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the learner")
    out: Path | None = Field(None, description="run folder; default runs/NAME-sensitivity", strict=False)


def main(arguments: Sequence[str]) -> int:
    """Verb `sensitivity`."""
    options, scenario = parse_scenario(SensitivityOptions, arguments, "sensitivity", "Vary the reward parameters one at a time.")
    folder = options.out or Path("runs") / f"{scenario.name}-sensitivity"
    with hold(folder):
        run = open_or_create_run(folder, scenario, command_line(), options.seed)
        with share_bar("sensitivity") as progress:
            dataset = sensitivity(run, options.learned, progress)
        if dataset is None:
            err.print("stopped; call the same command again to go on")
            return 130
        table = Table(title="exact figures over all pairs")
        names = list(dataset.data_vars)
        for name in map(str, names):
            heading = METRICS[name].heading if name in METRICS else name
            table.add_column(heading, justify="right", no_wrap=name not in METRICS)
        for point in range(dataset.sizes["point"]):
            values = [dataset[column].values[point] for column in names]
            table.add_row(*(v if isinstance(v, str) else f"{v:.4g}" for v in values))
        out.print(table)
        from cellpilot.report.figures import draw_study

        out.print(f"picture: {draw_study(run.folder, 'sensitivity')}")
    return 0
