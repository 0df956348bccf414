"""`cellpilot ablation SCENARIO`: the learner with and without double Q and hindsight (Figure 5.19)."""

import os
from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import err, out, share_bar
from cellpilot.cli.options import command_line, parse, scenario_argument
from cellpilot.runs import open_or_create_run
from cellpilot.scenario import LearnerSettings, MapSettings, Scenario, Settings, SimulatedMap, TaskSettings
from cellpilot.studies import EARLY_EPISODES, ablation, early_return


class AblationOptions(Settings):
    """Options of `ablation`."""

    scenario: tyro.conf.Positional[str] = Field("thesis-2d", description="TOML file or name of a shipped scenario")
    seeds: int = Field(5, ge=1, description="seeds 0..N-1 of each variant (section 5.4: 5)")
    jobs: int = Field(os.cpu_count() or 1, ge=1, description="trainings at a time")
    out: Path | None = Field(None, description="run folder; default runs/NAME-ablation; called again, it goes on", strict=False)
    map: MapSettings = SimulatedMap()
    task: TaskSettings = TaskSettings()
    learner: LearnerSettings = LearnerSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `ablation`."""
    found = scenario_argument(arguments)
    name, scenario = found if found else ("thesis-2d", Scenario())
    default = AblationOptions(scenario=name, map=scenario.map, task=scenario.task, learner=scenario.learner)
    options = parse(AblationOptions, arguments, "cellpilot ablation", "Four variants of the learner over seeds.", default)
    scenario = scenario.model_copy(update={"map": options.map, "task": options.task, "learner": options.learner})
    run = open_or_create_run(options.out or Path("runs") / f"{scenario.name}-ablation", scenario, command_line())
    with share_bar("ablation") as progress:
        dataset = ablation(run, options.seeds, options.jobs, progress)
    if dataset is None:
        err.print("stopped; call the same command again to go on")
        return 130
    table = Table(title=f"mean return over the first {EARLY_EPISODES} episodes, {options.seeds} seeds")
    for column in ("variant", "mean", "standard deviation"):
        table.add_column(column, justify="left" if column == "variant" else "right")
    for variant, (mean, spread) in early_return(dataset).items():
        table.add_row(variant, f"{mean:.2f}", f"{spread:.2f}")
    out.print(table)
    from cellpilot.report.figures import draw_study

    out.print(f"picture: {draw_study(run.folder, 'ablation')}")
    return 0
