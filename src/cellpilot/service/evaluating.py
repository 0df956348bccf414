"""Baseline, optimum and learned policy of a run on the same instances."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from cellpilot.errors import InputError
from cellpilot.evaluate import Evaluation
from cellpilot.evaluate.evaluation import Progress, most_goals
from cellpilot.experiment import divergence_warning, make_world, threshold_warning
from cellpilot.maps import RadioMap, load_map
from cellpilot.runs import Run, evaluate_run, origin_warning, payload, save_evaluation
from cellpilot.service.callbacks import Warn, as_warning, tell, untold
from cellpilot.service.sources import load_run


@dataclass(frozen=True)
class Evaluated:
    """An evaluation of a run: not in its folder until `save`."""

    run: Run
    evaluation: Evaluation
    on_own_map: bool

    @property
    def payload(self) -> dict[str, Any]:
        """Metrics by policy as plain data for JSON."""
        return payload(self.run, self.evaluation)

    @property
    def can_be_saved(self) -> bool:
        """Whether it belongs into the run's folder: that of the run's own map, where there is a folder."""
        return self.on_own_map and self.run.saved

    def save(self) -> Path:
        """Write `eval.nc` into the run's folder; `WriteError` where it cannot be, `InputError` where it does not belong."""
        if not self.can_be_saved:
            why = "a shipped policy has no folder" if self.on_own_map else "it is of another map than the run's"
            raise InputError(f"{self.run.folder}: the evaluation cannot be saved there: {why}")
        return save_evaluation(self.run, self.evaluation)


def evaluate(
    run: Run | str | Path,
    radio_map: RadioMap | str | Path | None = None,
    *,
    progress: Progress = untold,
    warn: Warn = as_warning,
) -> Evaluated:
    """Evaluate a run (itself, its folder, or the name of a shipped scenario with a policy), or fly it over another map.

    `InputError` if the run or the map cannot be read, or the map has another grid.
    """
    run = run if isinstance(run, Run) else load_run(run)
    other = load_map(radio_map) if isinstance(radio_map, str | Path) else radio_map
    world = run.world if other is None else make_world(other, run.scenario.task.noise_std_db, run.scenario.airspace)
    tell(warn, threshold_warning(world, run.task.threshold_db))
    parameters = run.parameters()
    if parameters is not None:
        tell(warn, origin_warning(parameters, run.radio_map, run.task, run.seed))
        tell(warn, divergence_warning(parameters, run.world, run.task))
    evaluation = evaluate_run(run, other, progress)
    n_goals = most_goals(world)
    if not evaluation.exhaustive and n_goals is not None:
        warn(
            f"on {world.grid.n_cells:,} cells the sampled flights lead to {n_goals} goals: with others the figures may differ by"
            " more than the intervals say"
        )
    return Evaluated(run, evaluation, other is None)
