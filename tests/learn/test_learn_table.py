"""Learners by name, and one of somebody else's in one file: trained, resumed, saved, evaluated and reported like the others."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellpilot import plugins
from cellpilot.errors import InputError
from cellpilot.learn.algorithms import table
from cellpilot.learn.algorithms.base import LearnerSettings
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.learn.checkpoint import named_leaves
from cellpilot.learn.learner import Place
from cellpilot.learn.trainer import TrainingProgress, train_many, train_one
from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy, load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.scenario import LEARNERS
from cellpilot.task import Task
from cellpilot.world import World

EXAMPLE = Path(__file__).parents[2] / "examples" / "q_learning.py"
TASK = Task(max_steps=30)


def example() -> Any:
    """The worked example as a module."""
    spec = importlib.util.spec_from_file_location("q_learning", EXAMPLE)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


BRIEF_REPLAY = {"episodes": 6, "replay_capacity": 900, "replay_start": 60, "updates_per_episode": 2, "hidden_units": 8}
BRIEF: dict[str, LearnerSettings] = {
    "ddqn-her": DDQNHER(**BRIEF_REPLAY),
    "ddqn-her-variants": DDQNHERVariants(**BRIEF_REPLAY, double=False),
    "fqi-her": FQIHER(rounds=6, flights=4, updates_per_round=2, goals_per_round=4, batch_size=16, hidden_units=8),
    "map-learner": MapLearning(flights=6, estimate_after_flights=(2, 4)),
    "q-learning": example().QLearning(flights=6),
}


@pytest.fixture(scope="module")
def place(random_world: Callable[..., World]) -> Place:
    return Place(random_world(5, (4, 3, 1), 0.15, noise_std_db=2.0), TASK)


def test_every_learner_of_the_table_is_tried_here() -> None:
    assert set(BRIEF) == set(LEARNERS) | {"q-learning"}
    for name, settings in LEARNERS.items():
        assert settings.model_fields["algorithm"].default == name


@pytest.mark.parametrize("name", BRIEF)
def test_a_learner_resumes_bit_for_bit_and_seeds_differ(tmp_path: Path, place: Place, name: str) -> None:
    settings, seen, file = BRIEF[name], list[TrainingProgress](), tmp_path / "state.safetensors"
    whole = train_one(settings, place, 2, chunk_rounds=6, progress=seen.append)
    assert [(p.done, p.rounds) for p in seen] == [(6, 6)]
    assert whole.finished
    assert {"episode_return", "n_steps", "reached", "exploration"} <= whole.history.keys()
    assert {len(column) for column in whole.history.values()} == {6}
    assert whole.env_steps >= 6
    left = iter([False, True])
    part = train_one(settings, place, 2, checkpoint=file, chunk_rounds=3, interrupted=lambda: next(left))
    assert not part.finished
    resumed = train_one(settings, place, 2, checkpoint=file, chunk_rounds=2)
    for leaf, value in named_leaves(whole.state).items():
        assert np.asarray(value).tobytes() == np.asarray(named_leaves(resumed.state)[leaf]).tobytes(), leaf
    for column, values in whole.history.items():
        np.testing.assert_array_equal(resumed.history[column], values)
    other = train_one(settings, place, 3, chunk_rounds=6)
    assert other.history["episode_return"].tolist() != whole.history["episode_return"].tolist()


@pytest.mark.parametrize("name", BRIEF)
def test_what_is_learned_is_saved_and_flies_from_its_file(tmp_path: Path, place: Place, name: str) -> None:
    first, second = train_many(BRIEF[name], place, (2, 3))
    about, grid = {"task": TASK.as_dict()}, place.world.grid
    goals = place.world.airspace.free_cells
    tables = []
    for result in (first, second):
        parameters = result.policy_parameters(about).trained_in(place.world.airspace)
        save_parameters(parameters, tmp_path / "p.safetensors")
        found = load_parameters(tmp_path / "p.safetensors")
        np.testing.assert_array_equal(found.values(grid, goals), parameters.values(grid, goals))
        tables.append(found.values(grid, goals).tobytes())
    assert tables[0] != tables[1]


def test_the_map_learner_of_a_run_flies_in_one_drawn_world(random_world: Callable[..., World]) -> None:
    """What is unknown of the map is one error of the whole training: a cell measured twice shows the same value."""
    world = random_world(5, (3, 3, 1), noise_std_db=0.0, sinr_std_db=4.0)
    states = [train_one(MapLearning(flights=4, estimate_after_flights=(2,)), Place(world, TASK), seed).state for seed in (0, 1)]
    errors = []
    for state in states:
        n = int(state.arrays["n_steps"].sum())
        cells, sinr_db = state.arrays["cells"][:n], state.arrays["sinr_db"][:n]
        assert len(set(zip(cells.tolist(), sinr_db.tolist(), strict=True))) == len(set(cells.tolist())) < n
        errors.append(float((sinr_db - world.signal.mean_db[cells])[0]))
    assert errors[0] != errors[1]
    assert all(error != 0 for error in errors)


def test_the_map_learner_refuses_a_map_with_holes_and_one_that_is_too_large(make_world: Callable[..., World]) -> None:
    with pytest.raises(InputError, match="SINR in every free cell"):
        train_one(MapLearning(), Place(make_world((3, 1, 1), [3.0, -np.inf, 3.0]), TASK), 0)
    with pytest.raises(InputError, match="3,000 cells"):
        train_one(MapLearning(), Place(make_world((60, 60, 1)), TASK), 0)


def test_the_example_learns_and_the_map_learner_reaches_the_optimum(random_world: Callable[..., World]) -> None:
    from cellpilot.evaluate.exact import exhaustive_summary
    from cellpilot.evaluate.metrics import score

    world = random_world(3, (5, 5, 1))
    greedy, optimal = (exhaustive_summary(None, world, TASK, p) for p in (GreedyPolicy(world), OptimalPolicy(world, TASK)))
    for settings, least in ((example().QLearning(flights=800), 0.9), (MapLearning(flights=20), 0.95)):
        parameters = train_one(settings, Place(world, TASK), 0).policy_parameters({"task": TASK.as_dict()})
        found = exhaustive_summary(None, world, TASK, LearnedPolicy(parameters, world.grid))
        assert (score(found, greedy, optimal) or 0.0) > least, settings.algorithm


class _Point(EntryPoint):
    def load(self) -> Any:
        return {"q": example().QLearning, "no": dict}[self.value]


@pytest.mark.parametrize(
    ("point", "wrong"),
    [
        (_Point("q-learning", "q", table.GROUP), None),
        (_Point("other-name", "q", table.GROUP), "other-name"),
        (_Point("fqi-her", "q", table.GROUP), "fqi-her"),
        (_Point("nothing", "no", table.GROUP), "no subclass"),
        (EntryPoint("gone", "no_such_module:Learner", table.GROUP), "cannot be imported"),
    ],
    ids=lambda value: getattr(value, "name", value),
)
def test_an_installed_package_offers_its_learner(monkeypatch: pytest.MonkeyPatch, point: EntryPoint, wrong: str | None) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == "cellpilot.learners" else [])
    monkeypatch.setattr(table, "offered", plugins.offered.__wrapped__)
    if wrong is None:
        assert set(table.learners.__wrapped__()) == set(table.OWN) | {"q-learning"}
    else:
        with pytest.raises(InputError, match=wrong):
            table.learners.__wrapped__()


def test_own_learners_stay_as_they_are(place: Place) -> None:
    """A learner of a place with a fixed start and goal flies between them alone."""
    start, goal = (tuple(int(i) for i in place.world.grid.position(cell)) for cell in place.world.airspace.free_cells[[0, -1]])
    for name in ("map-learner", "q-learning"):
        result = train_one(BRIEF[name], replace(place, start=start, goal=goal), 0)
        assert (result.history["n_steps"] >= sum(abs(a - b) for a, b in zip(start, goal, strict=True))).all()
