"""Every setting is described, carries its unit, and changes what is made of it: no option does nothing."""

import shutil
from collections.abc import Callable
from dataclasses import astuple, replace
from importlib.resources import files
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from cellpilot.errors import InputError
from cellpilot.experiment import build_map, fingerprint, make_deployment, make_task
from cellpilot.grid import Grid
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.policies import PolicyParameters
from cellpilot.policies.learned import save_parameters
from cellpilot.runs import create_run, evaluate_run
from cellpilot.scenario import (
    LEARNERS,
    EvaluationSettings,
    MapFile,
    MeasuredMap,
    Scenario,
    Settings,
    SimulatedMap,
    TaskSettings,
)
from cellpilot.signal import Unknown
from cellpilot.world import World

UNITS = {"_m": "[m]", "_db": "[dB]", "_dbm": "[dBm]", "_hz": "[Hz]", "_deg": "[deg]", "_wavelengths": "[wavelengths]"}
SECTIONS = (SimulatedMap, MeasuredMap, MapFile, TaskSettings, *LEARNERS.values(), EvaluationSettings)
SMALL = SimulatedMap(bin_m=100.0, points_per_side=2)

CHANGED_MAP = {
    "heights_m": (60.0,),
    "x_range_m": (-200.0, 300.0),
    "y_range_m": (-300.0, 200.0),
    "bin_m": 80.0,
    "points_per_side": 3,
    "environment": "RMa-AV",
    "los": "los",
    "shadowing_seed": 1,
    "rings": 2,
    "inter_site_distance_m": 600.0,
    "boresights_deg": (0.0, 120.0, 240.0),
    "base_height_m": 30.0,
    "power_dbm": 20.0,
    "carrier_hz": 3.5e9,
    "bandwidth_hz": 20e6,
    "noise_figure_db": 30.0,
    "load": 0.5,
    "antenna_elements": 4,
    "antenna_spacing_wavelengths": 0.5,
    "electrical_tilt_deg": 12.0,
    "mechanical_tilt_deg": 5.0,
    "array_factor_floor_db": -10.0,
}
CHANGED_TASK = {
    "rho_goal": 5.0,
    "rho_sinr": -2.0,
    "rho_step": -0.2,
    "rho_blocked": -0.5,
    "rho_end": -7.0,
    "threshold_db": 6.0,
    "discount": 0.3,
    "max_steps": 17,
}
CHANGED_LEARNER = {
    "episodes": 10,
    "batch_size": 16,
    "replay_capacity": 60_000,
    "replay_start": 10,
    "updates_per_episode": 3,
    "target_period": 3,
    "learning_rate": 1e-2,
    "exploration": "epsilon-greedy",
    "initial_exploration": 1.0,
    "final_exploration": 0.3,
    "exploration_fraction": 0.2,
    "hindsight": False,
    "hindsight_ratio": 4,
    "hindsight_strategy": "final",
    "double": False,
    "clip_targets": False,
    "architecture": "two-stream",
    "hidden_layers": 2,
    "hidden_units": 20,
    "n_steps": 3,
    "prioritised": True,
    "priority_exponent": 0.7,
    "importance_exponent": 0.0,
    "networks": 2,
}


@pytest.mark.parametrize("section", SECTIONS, ids=lambda section: section.__name__)
def test_every_setting_is_described_with_its_unit(section: type[Settings]) -> None:
    for name, field in section.model_fields.items():
        if name == "kind":
            continue
        assert field.description, name
        for suffix, unit in UNITS.items():
            if name.endswith(suffix):
                assert unit in field.description, f"{name}: {field.description}"


@pytest.mark.parametrize("section", [*SECTIONS, Scenario], ids=lambda section: section.__name__)
def test_settings_are_frozen_and_refuse_unknown_keys(section: type[Settings]) -> None:
    settings = section()
    name = next(iter(section.model_fields))
    with pytest.raises(ValidationError):
        setattr(settings, name, "other")
    with pytest.raises(ValidationError):
        section(no_such_setting=1)


def test_the_tables_below_miss_no_setting() -> None:
    assert set(CHANGED_MAP) == set(SimulatedMap.model_fields) - {"kind", "sites", "anchor"}  # a site list: test_maps_sites.py
    assert set(CHANGED_TASK) | {"start", "goal", "noise_std_db"} == set(TaskSettings.model_fields)
    assert set(CHANGED_LEARNER) == set(DDQNHERVariants.model_fields) - {"algorithm"}


@pytest.mark.parametrize("name", CHANGED_MAP)
def test_every_setting_of_a_simulated_map_changes_the_map(name: str) -> None:
    before, after = build_map(SMALL), build_map(SMALL.model_copy(update={name: CHANGED_MAP[name]}))
    assert not before[["sinr_db"]].equals(after[["sinr_db"]])


def test_the_deployment_carries_the_settings() -> None:
    deployment = make_deployment(SimulatedMap(**{name: value for name, value in CHANGED_MAP.items() if name != "los"}))
    assert [np.unique(deployment.carrier_hz), np.unique(deployment.bandwidth_hz)] == [3.5e9, 20e6]
    assert deployment.noise_figure_db == 30.0
    assert np.unique(deployment.height_m).tolist() == [30.0]
    assert deployment.n_sectors == 19 * 3
    assert sorted(np.unique(deployment.boresight_deg)) == [0.0, 120.0, 240.0]


@pytest.mark.parametrize("name", CHANGED_TASK)
def test_every_setting_of_a_task_arrives_in_the_task_under_its_name(name: str) -> None:
    grid = Grid((0.0, 1.0), (0.0, 1.0), (30.0,))
    before = make_task(TaskSettings(), grid)
    after = make_task(TaskSettings(**{name: CHANGED_TASK[name]}), grid)
    assert getattr(after, name) == CHANGED_TASK[name] != getattr(before, name)
    assert sum(a != b for a, b in zip(astuple(before), astuple(after), strict=True)) == 1


def test_switching_hindsight_off_leaves_no_hindsight_goal() -> None:
    assert DDQNHERVariants(hindsight=False, hindsight_ratio=4).copies == 1
    assert DDQNHERVariants(hindsight_ratio=4).copies == 5
    assert DDQNHER(hidden_layers=2, hidden_units=7).hidden == (7, 7)


def test_the_published_learner_has_no_switch_and_the_variants_have_all_its_settings() -> None:
    published, variants = set(DDQNHER.model_fields), set(DDQNHERVariants.model_fields)
    assert published < variants
    for name in published - {"algorithm"}:
        assert getattr(DDQNHER(), name) == getattr(DDQNHERVariants(), name)


@pytest.mark.parametrize("section", ["task", "learner"])
def test_a_changed_setting_changes_the_fingerprint_of_a_training(section: str) -> None:
    world = World.from_map(build_map(SMALL))
    base = Scenario(learner=DDQNHERVariants(initial_exploration=0.9))
    changes = (
        CHANGED_TASK | {"noise_std_db": 1.0, "start": (0, 0, 0), "goal": (1, 1, 0)} if section == "task" else CHANGED_LEARNER
    )
    marks = {fingerprint(base, world)}
    for name, value in changes.items():
        settings = getattr(base, section).model_copy(update={name: value})
        marks.add(fingerprint(base.model_copy(update={section: settings}), world))
    assert len(marks) == len(changes) + 1


@pytest.fixture
def log(tmp_path: Path) -> Path:
    """The synthetic log at 30 m under a name that gives its height."""
    path = tmp_path / "30m.csv"
    path.write_bytes(files("cellpilot").joinpath("data", "synthetic_30m.csv").read_bytes())
    return path


@pytest.mark.parametrize(
    ("name", "value"),
    [("altitude_m", 44.0), ("bin_m", 50.0), ("fill_radius_m", 0.0), ("mask", "none"), ("unknown", "bad")],
)
def test_every_setting_of_a_measured_map_changes_the_map(log: Path, name: str, value: object) -> None:
    before = build_map(MeasuredMap(logs=(log,)))
    after = build_map(MeasuredMap(logs=(log,), **{name: value}))
    assert not before.equals(after)


def test_two_logs_are_two_heights(log: Path) -> None:
    other = shutil.copy(log, log.with_name("70m.csv"))
    assert build_map(MeasuredMap(logs=(log, Path(other))))["z"].values.tolist() == [30.0, 70.0]


@pytest.fixture(scope="session")
def metrics_of(tmp_path_factory: pytest.TempPathFactory) -> Callable[[Scenario], str]:
    """Every figure of an evaluation, with a learned policy of random weights."""
    rng = np.random.default_rng(0)
    weights = {}
    for i, (n_in, n_out) in enumerate(pairwise((4, 8, 4))):
        weights[f"network.layers.{i}.weight"] = rng.normal(size=(n_out, n_in)).astype(np.float32)
        weights[f"network.layers.{i}.bias"] = rng.normal(size=n_out).astype(np.float32)

    def evaluate(scenario: Scenario) -> str:
        run = create_run(tmp_path_factory.mktemp("run"), scenario, 0, "test")
        save_parameters(PolicyParameters(weights, "concatenated", run.world.grid.sides), run.policy_file)
        evaluation = evaluate_run(run)
        return repr((evaluation.exhaustive, evaluation.policies, evaluation.sampled))

    return evaluate


@pytest.mark.parametrize(
    ("section", "name", "value"),
    [("task", name, value) for name, value in CHANGED_TASK.items() if name not in ("rho_blocked", "rho_end")]
    + [("task", "noise_std_db", 4.0), ("task", "start", (0, 0, 0)), ("task", "goal", (1, 1, 0))]
    + [
        ("evaluation", "n_sampled", 60),
        ("evaluation", "seed", 1),
        ("evaluation", "boltzmann_temperature", 1.0),
        ("evaluation", "max_exhaustive_pairs", 10),
    ],
)
def test_every_setting_of_task_and_evaluation_changes_the_figures(
    metrics_of: Callable[[Scenario], str], section: str, name: str, value: object
) -> None:
    # At 8 dB there is something to fly around, so that even the discount shows.
    base = Scenario(map=SMALL, task=TaskSettings(threshold_db=8.0), evaluation=EvaluationSettings(n_sampled=50))
    changed = getattr(base, section).model_copy(update={name: value})
    assert metrics_of(base) == metrics_of(base)
    assert metrics_of(base) != metrics_of(base.model_copy(update={section: changed}))


def test_how_the_errors_of_a_map_hang_together_changes_the_fingerprint_of_a_training() -> None:
    world = World.from_map(build_map(SMALL))
    grid, std_db = world.grid, np.full(world.grid.n_cells, 3.0, np.float32)
    marks = set()
    for correlation_m, common_std_db in ((0.0, 0.0), (50.0, 0.0), (50.0, 1.0), (50.0, 2.0)):
        unknown = Unknown.of(grid, std_db, correlation_m, common_std_db)
        marks.add(fingerprint(Scenario(), replace(world, signal=replace(world.signal, unknown=unknown))))
    assert len(marks) == 4


def test_changed_is_a_checked_copy() -> None:
    settings = SimulatedMap()
    assert settings.changed(rings=2, load=0.5) == SimulatedMap(rings=2, load=0.5)
    assert settings == SimulatedMap()
    for changes, message in (
        ({"rings": -1}, "^rings is -1: "),
        ({"ringz": 1}, "^ringz is no setting; expected one of "),
        ({"sites": Path("a.csv"), "rings": 3}, "^SimulatedMap: rings belongs to the hexagonal deployment"),
    ):
        with pytest.raises(InputError, match=message):
            settings.changed(**changes)
