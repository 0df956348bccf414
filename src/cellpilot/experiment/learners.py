"""Settings of the scenario's learner as compiled code needs them, and whether it can be trained so."""

from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.base import AlgorithmSettings
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.scenario import AnyLearnerSettings, LearnerSettings, PairLearnerSettings
from cellpilot.task import Task


def make_learner(settings: AnyLearnerSettings) -> AlgorithmSettings:
    """Settings of the scenario's algorithm as compiled code needs them."""
    if isinstance(settings, PairLearnerSettings):
        return FQIHER(**settings.model_dump(exclude={"algorithm"}))
    return _ddqn_her(settings)


def _ddqn_her(settings: LearnerSettings) -> DDQNHER:
    return DDQNHER(
        episodes=settings.episodes,
        batch_size=settings.batch_size,
        replay_capacity=settings.replay_capacity,
        replay_start=settings.replay_start,
        updates_per_episode=settings.updates_per_episode,
        target_period=settings.target_period,
        learning_rate=settings.learning_rate,
        exploration=settings.exploration,
        initial_exploration=settings.initial_exploration,
        final_exploration=settings.final_exploration,
        exploration_fraction=settings.exploration_fraction,
        hindsight_ratio=settings.hindsight_ratio if settings.hindsight else 0,
        hindsight_strategy=settings.hindsight_strategy,
        double=settings.double,
        clip_targets=settings.clip_targets,
        architecture=settings.architecture,
        hidden=(settings.hidden_units,) * settings.hidden_layers,
        n_steps=settings.n_steps,
        prioritised=settings.prioritised,
        priority_exponent=settings.priority_exponent,
        importance_exponent=settings.importance_exponent,
        networks=settings.networks,
    )


def check_learner(settings: AnyLearnerSettings, task: Task, grid: Grid, n_seeds: int = 1) -> None:
    """`InputError` before anything slow is imported if the learner cannot be trained so, that many seeds at once."""
    learner = make_learner(settings)
    learner.check_fits(task, n_seeds)
    if isinstance(learner, FQIHER):
        if learner.look_ahead > (most := 10 * sum(grid.sides)):
            raise InputError(f"look_ahead is {learner.look_ahead}; expected at most {most}, ten times the sides of this grid")
        learner.check_memory_fits(grid.sides, n_seeds)
