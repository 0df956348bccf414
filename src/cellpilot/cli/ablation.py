"""`cellpilot ablation SCENARIO`: the learner with and without double Q and hindsight (Figure 5.19)."""

from collections.abc import Sequence
from math import isnan
from pathlib import Path

from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import err, out, share_bar
from cellpilot.cli.devices import use_all_cores
from cellpilot.cli.options import ScenarioOptions, command_line, parse_scenario
from cellpilot.runs import open_or_create_run
from cellpilot.storage import hold
from cellpilot.studies.ablation import EARLY_EPISODES, ablation, check_ablation, early_return


class AblationOptions(ScenarioOptions):
    """Options of `ablation`."""

    seeds: int = Field(5, ge=1, description="seeds 0..N-1 of each variant (section 5.4: 5)")
    out: Path | None = Field(None, description="run folder; default runs/NAME-ablation; called again, it goes on", strict=False)


def main(arguments: Sequence[str]) -> int:
    """Verb `ablation`."""
    options, scenario = parse_scenario(AblationOptions, arguments, "ablation", "Four variants of the learner over seeds.")
    check_ablation(scenario)
    use_all_cores(options.seeds)
    folder = options.out or Path("runs") / f"{scenario.name}-ablation"
    with hold(folder):
        run = open_or_create_run(folder, scenario, command_line(), n_seeds=options.seeds)
        with share_bar("ablation") as progress:
            dataset = ablation(run, options.seeds, progress)
        if dataset is None:
            err.print("stopped; call the same command again to go on")
            return 130
        n_episodes = min(EARLY_EPISODES, dataset.sizes["episode"])
        table = Table(title=f"mean return over the first {n_episodes} episodes, {options.seeds} seeds")
        for column in ("variant", "mean", "standard deviation"):
            table.add_column(column, justify="left" if column == "variant" else "right")
        for variant, (mean, spread) in early_return(dataset).items():
            table.add_row(variant, f"{mean:.2f}", "-" if isnan(spread) else f"{spread:.2f}")
        out.print(table)
        from cellpilot.report.figures import draw_study

        out.print(f"picture: {draw_study(run.folder, 'ablation')}")
    return 0
