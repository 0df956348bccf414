"""`cellpilot run SCENARIO`: map, training, evaluation and report in one."""

import shlex
from collections.abc import Sequence
from contextlib import ExitStack
from pathlib import Path
from statistics import mean, stdev
from typing import TYPE_CHECKING

import numpy as np
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import err, out, share_bar, training_bar, warn
from cellpilot.cli.devices import use_all_cores
from cellpilot.cli.options import ScenarioOptions, command_line, parse, parse_scenario
from cellpilot.errors import InputError, WriteError
from cellpilot.evaluate.metrics import all_metrics
from cellpilot.learn.history import mean_of_flights
from cellpilot.runs import Run, evaluate_run, payload, save_evaluation
from cellpilot.scalars import ask_for_log, log_evaluation, logged_progress, require_writer
from cellpilot.scenario import EvaluationSettings, Paths, Settings
from cellpilot.service.training import resumed, started, train_held

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress, TrainingResult


FIXED = ("--learner.", "--map.", "--task.", "--airspace.", "--evaluation.", "--seed", "--out", "--force")
"""How the options begin that a run which goes on cannot take."""


class RunOptions(ScenarioOptions):
    """Options of `run` and `train`."""

    out: Path | None = Field(None, description="run folder; default runs/NAME-seedSEED", strict=False)
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the learner (the map's is --map.shadowing-seed)")
    seeds: int = Field(1, ge=1, le=1000, description="train seeds SEED to SEED+N-1 at once, each in a folder OUT-seedK")
    force: bool = Field(False, description="replace a run that is already in the folder")
    tensorboard: bool = Field(False, description="write scalars for TensorBoard to RUN/tensorboard (extra tb)")
    evaluation: EvaluationSettings = EvaluationSettings()


class ResumeOptions(Settings):
    """Options of `run --resume` and `train --resume`."""

    resume: Paths = Field(description="run folders to go on with, all seeds at once; their own settings and seeds hold")
    tensorboard: bool = Field(False, description="write scalars for TensorBoard from now on (extra tb)")


def main(arguments: Sequence[str]) -> int:
    """Verb `run`."""
    with ExitStack() as held:
        runs = prepare_runs(arguments, "run", "Make the map, train, evaluate and write the report.", held)
        if train_with_bar(runs) is None:
            return 130
        _evaluate_and_report(runs)
    return 0


def _evaluate_and_report(runs: Sequence[Run]) -> None:
    """Evaluate each run, print its figures, and then save them: what cannot be saved is not lost."""
    from cellpilot.report import write_report
    from cellpilot.report.tables import text_table

    figures: list[dict[str, dict[str, float | None]]] = []
    for run in runs:
        with share_bar("evaluate") as progress:
            evaluation = evaluate_run(run, progress=progress)
        figures.append(payload(run, evaluation)["policies"])
        if len(runs) == 1:
            out.print(text_table(payload(run, evaluation)))
        save_evaluation(run, evaluation)
        log_evaluation(run.folder, figures[-1], run.scenario.learner.n_rounds)
        out.print(f"report: {write_report(run.folder)}")
    if len(runs) > 1:
        out.print(policies_over_seeds(figures))


def prepare_runs(arguments: Sequence[str], verb: str, description: str, held: ExitStack) -> list[Run]:
    """The runs to train, one per seed: new folders, or those named by `--resume`; all are held until `held` ends."""
    if any(argument.startswith("--resume") for argument in arguments):
        _refuse_settings(arguments, verb)
        asked = parse(ResumeOptions, arguments, f"cellpilot {verb}", description)
        use_all_cores(len(asked.resume))
        return _logged(held.enter_context(resumed(asked.resume, warn)), asked.tensorboard)
    description += f" To go on with an interrupted run: cellpilot {verb} --resume RUN ..."
    options, scenario = parse_scenario(RunOptions, arguments, verb, description)
    seeds = range(options.seed, options.seed + options.seeds)
    if seeds[-1] >= 2**31:
        raise InputError(f"--seed {options.seed} --seeds {options.seeds}: the last seed has to be below {2**31}")
    if options.tensorboard:
        require_writer()
    use_all_cores(options.seeds)
    runs = held.enter_context(started(scenario, options.out, seeds, command_line(), force=options.force, warn=warn))
    return _logged(runs, options.tensorboard)


def _refuse_settings(arguments: Sequence[str], verb: str) -> None:
    """`InputError` for a setting beside --resume: a run goes on as it began."""
    for argument in arguments:
        name = argument.partition("=")[0]
        if name.startswith(FIXED):
            raise InputError(
                f"{name} with --resume: a run goes on with its own settings and seed, and its length is fixed by its schedules"
                f" of exploration and learning rate; for others start a new one (cellpilot {verb} SCENARIO {name} ...)"
            )


def _logged(runs: list[Run], tensorboard: bool) -> list[Run]:
    if tensorboard:
        for run in runs:
            ask_for_log(run.folder)
    return runs


def train_with_bar(runs: Sequence[Run]) -> "list[TrainingResult] | None":
    """Train and say how it went; None if it was interrupted."""
    learner = runs[0].scenario.learner
    bar = training_bar(learner.n_rounds, learner.counts, learner.explores_by)
    try:
        with logged_progress([run.folder for run in runs], learner.chunk_rounds) as log, bar as show:

            def both(progress: "TrainingProgress") -> None:
                show(progress)
                log(progress)

            results = train_held(runs, both, warn, lambda: err.print("stopping; Ctrl-C again to stop at once"))
    except WriteError as error:
        raise WriteError(f"{error}; then go on with --resume {_folders(runs)}") from None
    except ImportError as error:
        raise InputError(f"training needs JAX, which cannot be imported ({error}); see cellpilot doctor") from error
    if not all(result.finished for result in results):
        n_rounds = min(len(result.history["reached"]) for result in results)
        err.print(f"stopped after {n_rounds} {learner.counts}; go on with --resume {_folders(runs)}")
        return None
    for run, result in zip(runs, results, strict=True):
        together = f", {len(runs)} seeds together" if len(runs) > 1 else ""
        seconds = f"{result.train_wall_s:.0f} s (compilation {result.compile_s:.0f} s{together})"
        err.print(f"trained in {seconds}: {run.policy_file}")
    return results


def _folders(runs: Sequence[Run]) -> str:
    """The folders as they are written on a command line."""
    return shlex.join(str(run.folder) for run in runs)


def policies_over_seeds(figures: Sequence[dict[str, dict[str, float | None]]]) -> Table:
    """Mean and standard deviation over the seeds of each policy's main figures."""
    columns = {
        name: all_metrics()[name] for name in ("reached_share", "low_sinr_share", "path_ratio_p90", "return_mean", "score")
    }
    percent = {name: metric.form == "percent" for name, metric in columns.items()}
    headings = [f"{metric.short or metric.label} [%]" if percent[name] else metric.label for name, metric in columns.items()]
    table = seeds_table(len(figures), "policy", headings)
    for policy in figures[0]:
        rows = [figure[policy] for figure in figures]
        table.add_row(policy, *(mean_and_spread([row[name] for row in rows], 100 if percent[name] else 1) for name in columns))
    return table


def training_over_seeds(results: "Sequence[TrainingResult]") -> Table:
    """Return and share that reached over the last tenth of training: each seed, then mean and standard deviation."""
    table = seeds_table(len(results), "seed", ("return", "reached [%]"))
    last = max(1, results[0].settings.n_rounds // 10)
    mean_of = lambda result, name: mean_of_flights(result.history, name, slice(-last, None))
    means = [[mean_of(result, name) for name in ("episode_return", "reached")] for result in results]
    figures = [[None if np.isnan(mean) else mean for mean in row] for row in means]
    for seed, (mean_return, reached) in zip((result.seed for result in results), figures, strict=True):
        words = ["-" if value is None else f"{scale * value:.3f}" for value, scale in ((mean_return, 1), (reached, 100))]
        table.add_row(str(seed), *words)
    returns, reached_shares = zip(*figures, strict=True)
    table.add_row("mean ± sd", mean_and_spread(returns, 1), mean_and_spread(reached_shares, 100))
    return table


def seeds_table(n_seeds: int, first: str, columns: Sequence[str]) -> Table:
    """An empty table with its title and columns."""
    table = Table(title=f"mean ± standard deviation over {n_seeds} seeds")
    for column in (first, *columns):
        table.add_column(column, justify="left" if column == first else "right")
    return table


def mean_and_spread(values: Sequence[float | None], scale: float) -> str:
    """Text of mean and standard deviation; a dash if a value is missing."""
    known = [scale * value for value in values if value is not None]
    if len(known) < len(values):
        return "-"
    return f"{mean(known):.3f} ± {stdev(known):.3f}" if len(known) > 1 else f"{mean(known):.3f}"
