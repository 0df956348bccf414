"""A learner of one's own, complete in one file: tabular Q-learning (Watkins 1989), one table of values for each goal.

It is trained, evaluated and reported like those of cellpilot:

    python examples/q_learning.py

An installed package offers it to every command as `--learner.algorithm q-learning` by one line of its `pyproject.toml`:

    [project.entry-points."cellpilot.learners"]
    q-learning = "my_package.q_learning:QLearning"
"""

from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.evaluate import evaluate_policies
from cellpilot.evaluate.instances import sample_pairs
from cellpilot.experiment import build_map, make_task, make_world
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.base import LearnerSettings
from cellpilot.learn.in_turn import FlightRow, InTurn
from cellpilot.learn.learner import Learner, Place
from cellpilot.learn.trainer import train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, PolicyParameters
from cellpilot.policies.tables import Q_TABLE
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.task import Task, Transition


class QLearning(LearnerSettings):
    """Settings; each field is a key in TOML and a flag on the command line."""

    counts: ClassVar[str] = "flights"
    chunk_rounds: ClassVar[int] = 200

    algorithm: Literal["q-learning"] = Field("q-learning", description="tabular Q-learning")
    flights: int = Field(4_000, ge=1, description="flights from which the table is learned")
    learning_rate: float = Field(0.5, gt=0, le=1, description="share of a new value in the table")
    epsilon: float = Field(0.3, ge=0, le=1, description="share of random moves")

    @property
    def n_rounds(self) -> int:
        """A round is one flight."""
        return self.flights

    @property
    def updates(self) -> int:
        """No optimizer."""
        return 0

    @property
    def explores_by(self) -> str:
        """What the learning curve shows beside the return."""
        return "epsilon"

    def check_fits(self, task: Task, grid: Grid, n_seeds: int = 1) -> None:
        """A table fits where a map of a few hundred cells does."""
        if grid.n_cells > 1_000:
            raise ValueError(f"q-learning keeps a value for each pair of cells; {grid.n_cells:,} cells are too many")

    def learner(self, place: Place) -> Learner:
        """One table for each seed."""
        return InTurn(lambda seed: Table(self, place, seed), lambda flights: np.full(np.shape(flights), self.epsilon))


class Table:
    """Q(cell, goal, action) of one seed. Every step teaches all goals at once, since its facts do not depend on the goal."""

    def __init__(self, settings: QLearning, place: Place, seed: int) -> None:
        airspace = place.world.airspace
        self.settings, self.place, self.seed = settings, place, seed
        self.q = np.where(airspace.offered[:, None, :], 0.0, -np.inf).repeat(airspace.grid.n_cells, axis=1)

    def fly(self, number: int) -> FlightRow:
        """One flight with the epsilon-greedy policy."""
        rng = np.random.default_rng([self.seed, number])
        world, task = self.place.world, self.place.task
        airspace, goals = world.airspace, np.arange(world.grid.n_cells)
        pair = sample_pairs(rng, world, 1, self.place.start, self.place.goal)
        cell, goal, total, reached = int(pair.start[0]), int(pair.goal[0]), 0.0, False
        error_db = None if world.signal.unknown is None else world.signal.unknown.draw(rng.standard_normal(goals.size))
        n_steps, over = 0, False
        while not over and n_steps < task.max_steps:
            best = int(self.q[cell, goal].argmax())
            action = int(rng.choice(np.flatnonzero(airspace.offered[cell]))) if rng.random() < self.settings.epsilon else best
            next_cell, event = int(airspace.next_cell[cell, action]), airspace.event[cell, action]
            off_db = None if error_db is None else error_db[next_cell]
            sinr_db = world.signal.measure(next_cell, off_db, rng.standard_normal())
            outcome = task.outcome(Transition(cell, action, next_cell, sinr_db, event), goals)
            target = outcome.reward + task.discount * np.where(outcome.terminated, 0.0, self.q[next_cell].max(-1))
            self.q[cell, :, action] += self.settings.learning_rate * (target - self.q[cell, :, action])
            total += float(outcome.reward[goal])
            cell, reached, over, n_steps = next_cell, bool(outcome.reached[goal]), bool(outcome.terminated[goal]), n_steps + 1
        return FlightRow(total, n_steps, reached)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The table; moves that are not offered count as 0 here, since a learner's numbers are finite."""
        return {"q": np.where(np.isfinite(self.q), self.q, 0.0)}

    def restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        """The same table."""
        self.q = np.where(np.isfinite(self.q), arrays["q"], -np.inf)

    def policy_parameters(self, about: dict[str, Any]) -> PolicyParameters:
        """The table as a policy file takes it."""
        return PolicyParameters({"q": self.arrays()["q"].astype(np.float32)}, Q_TABLE, self.place.world.grid.sides, about)


def main() -> None:
    """Train on the quick scenario, and compare with baseline and optimum."""
    scenario = load_scenario(find_scenario("quick"))
    radio_map = build_map(scenario.map)
    world = make_world(radio_map, scenario.task.noise_std_db, scenario.airspace)
    task = make_task(scenario.task, world.grid)
    result = train_one(QLearning(), Place(world, task), seed=0)
    learned = LearnedPolicy(result.policy_parameters({"task": task.as_dict()}), world.grid)
    evaluation = evaluate_policies(
        world, task, [GreedyPolicy(world), OptimalPolicy(world, task), learned], seed=0, n_sampled=1_000
    )
    for name, figures in evaluation.policies.items():
        out.print(f"{name}: reached {figures['reached_share']:.1%}, score {figures['score']:.3f}")


if __name__ == "__main__":
    main()
