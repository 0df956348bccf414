"""`cellpilot run SCENARIO`: map, training, evaluation and report in one."""

from collections.abc import Sequence
from pathlib import Path

from pydantic import Field

from cellpilot.cli.console import err, out, share_bar, training_bar, warn
from cellpilot.cli.options import ScenarioOptions, command_line, parse, parse_scenario
from cellpilot.errors import InputError
from cellpilot.experiment import divergence_warning, make_learner, threshold_warning
from cellpilot.runs import Run, create_run, evaluate_run, open_run, payload, save_evaluation, train_run
from cellpilot.scenario import EvaluationSettings, Settings


class RunOptions(ScenarioOptions):
    """Options of `run` and `train`."""

    out: Path | None = Field(None, description="run folder; default runs/NAME-seedSEED", strict=False)
    seed: int = Field(0, ge=0, lt=2**31, description="seed of the learner (the map's is --map.shadowing-seed)")
    force: bool = Field(False, description="replace a run that is already in the folder")
    evaluation: EvaluationSettings = EvaluationSettings()


class ResumeOptions(Settings):
    """Options of `run --resume` and `train --resume`."""

    resume: Path = Field(description="run folder to go on with; its own settings and seed hold", strict=False)


def main(arguments: Sequence[str]) -> int:
    """Verb `run`."""
    run = prepare(arguments, "run", "Make the map, train, evaluate and write the report.")
    if not train_with_bar(run):
        return 130
    from cellpilot.report import write_report
    from cellpilot.report.tables import text_table

    with share_bar("evaluate") as progress:
        evaluation = evaluate_run(run, progress=progress)
    save_evaluation(run, evaluation)
    report = write_report(run.folder)
    out.print(text_table(payload(run, evaluation)))
    out.print(f"report: {report}")
    return 0


def prepare(arguments: Sequence[str], verb: str, description: str) -> Run:
    """The run to train: a new folder, or the one named by `--resume`."""
    if any(argument.startswith("--resume") for argument in arguments):
        resume = parse(ResumeOptions, arguments, f"cellpilot {verb}", description)
        return open_run(resume.resume)
    description += f" To go on with an interrupted run: cellpilot {verb} --resume RUN."
    options, scenario = parse_scenario(RunOptions, arguments, verb, description)
    folder = options.out or Path("runs") / f"{scenario.name}-seed{options.seed}"
    run = create_run(folder, scenario, options.seed, command_line(), options.force)
    warn(threshold_warning(run.world, run.task.threshold_db))
    return run


def train_with_bar(run: Run) -> bool:
    """Train and say how it went; False if it was interrupted."""
    try:
        learner = make_learner(run.scenario.learner)
        with training_bar(learner.rounds, learner.counts, learner.explores_by) as progress:
            result = train_run(run, progress)
    except ImportError as error:
        raise InputError(f"training needs JAX, which cannot be imported ({error}); see cellpilot doctor") from error
    if not result.finished:
        err.print(f"stopped after {len(result.history['reached'])} {learner.counts}; go on with --resume {run.folder}")
        return False
    parameters = run.parameters()
    assert parameters is not None
    warn(divergence_warning(parameters, run.world, run.task))
    err.print(f"trained in {result.train_wall_s:.0f} s (compilation {result.compile_s:.0f} s): {run.policy_file}")
    return True
