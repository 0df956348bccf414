"""`cellpilot evaluate RUN`: baseline, optimum and learned policy on the same instances."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from cellpilot.cli.console import out, share_bar, warn
from cellpilot.cli.options import parse
from cellpilot.errors import WriteError
from cellpilot.evaluate.evaluation import most_goals
from cellpilot.experiment import divergence_warning, make_world, threshold_warning
from cellpilot.runs import evaluate_run, open_run_or_shipped, origin_warning, payload, save_evaluation
from cellpilot.scenario import Settings


class EvaluateOptions(Settings):
    """Options of `evaluate`."""

    run: tyro.conf.Positional[str] = Field(description="run folder, or a shipped scenario with a trained policy")
    map: Path | None = Field(
        None, description="evaluate on this map instead (same grid); the evaluation is not saved", strict=False
    )
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = Field(False, description="print JSON and nothing else")


def main(arguments: Sequence[str]) -> int:
    """Verb `evaluate`."""
    options = parse(EvaluateOptions, arguments, "cellpilot evaluate", "Compare baseline, optimum and learned policy.")
    run = open_run_or_shipped(options.run)
    radio_map = None
    if options.map is not None:
        from cellpilot.maps import load_map

        radio_map = load_map(options.map)
    world = run.world if radio_map is None else make_world(radio_map, run.scenario.task.noise_std_db, run.scenario.airspace)
    warn(threshold_warning(world, run.task.threshold_db))
    parameters = run.parameters()
    if parameters is not None:
        warn(origin_warning(parameters, run.radio_map, run.task, run.seed))
        warn(divergence_warning(parameters, run.world, run.task))
    with share_bar("evaluate") as progress:
        evaluation = evaluate_run(run, radio_map, progress)
    n_goals = most_goals(world)
    if not evaluation.exhaustive and n_goals is not None:
        warn(
            f"on {world.grid.n_cells:,} cells the sampled flights lead to {n_goals} goals: with others the figures may differ by"
            " more than the intervals say"
        )
    if options.as_json:
        sys.stdout.write(json.dumps(payload(run, evaluation), indent=2) + "\n")
    else:
        from cellpilot.report.tables import mobility_table, text_table

        found = payload(run, evaluation)
        out.print(text_table(found))
        out.print(mobility_table(found))
    # Printed first: numbers that cannot be saved are not lost.
    if radio_map is None and run.saved:
        try:
            save_evaluation(run, evaluation)
        except WriteError as error:
            warn(f"the evaluation was not saved: {error}")
    return 0
