"""Scenario files: what is dumped loads equal, the shipped ones carry the thesis's values."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.ddqn_her_settings import DDQNHER, DDQNHERVariants
from cellpilot.scenario import (
    SHIPPED,
    EvaluationSettings,
    MapFile,
    MeasuredMap,
    Scenario,
    SimulatedMap,
    TaskSettings,
    dump_scenario,
    find_scenario,
    load_scenario,
)

finite = st.floats(allow_nan=False, allow_infinity=False)
positive = st.floats(min_value=0, exclude_min=True, allow_infinity=False)
non_negative = st.floats(min_value=0, allow_infinity=False)
share = st.floats(min_value=0, max_value=1, exclude_min=True)
count = st.integers(min_value=1, max_value=2**31 - 1)
# Any text a person or an editor can save: everything but halves of surrogate pairs.
text = st.text(st.characters(exclude_categories=["Cs"]), max_size=20)
# A name becomes a folder: see `Name`.
names = st.text(st.sampled_from("aZ9_äß東 .-+,()"), min_size=1, max_size=20).map(lambda name: f"n{name}n")
paths = text.map(Path)
cells = st.none() | st.tuples(st.integers(-5, 99), st.integers(-5, 99), st.integers(-5, 99))
pairs = st.tuples(finite, finite)

simulated = st.builds(
    SimulatedMap,
    heights_m=st.lists(finite, max_size=4).map(tuple),
    x_range_m=pairs,
    y_range_m=pairs,
    bin_m=positive,
    points_per_side=st.integers(1, 100),
    environment=st.sampled_from(["UMa-AV", "UMi-AV", "RMa-AV"]),
    los=st.sampled_from(["soft", "sampled", "los", "nlos"]),
    shadowing_seed=st.none() | st.integers(0, 2**31),
    rings=st.integers(0, 5),
    inter_site_distance_m=positive,
    boresights_deg=st.lists(finite, max_size=4).map(tuple),
    base_height_m=positive,
    power_dbm=st.floats(-100, 100),
    carrier_hz=positive,
    bandwidth_hz=positive,
    noise_figure_db=finite,
    load=st.floats(0, 1),
    antenna_elements=count,
    antenna_spacing_wavelengths=positive,
    electrical_tilt_deg=finite,
    mechanical_tilt_deg=finite,
    array_factor_floor_db=finite,
)
measured = st.builds(
    MeasuredMap,
    logs=st.lists(paths, max_size=3).map(tuple),
    altitude_m=st.none() | st.floats(0, 10_000),
    bin_m=positive,
    fill_radius_m=non_negative,
    mask=st.sampled_from(["auto", "none"]) | st.tuples(finite, finite, finite),
    unknown=st.sampled_from(["blocked", "bad"]),
)
tasks = st.builds(
    TaskSettings,
    rho_goal=finite,
    rho_sinr=finite,
    rho_step=finite,
    rho_blocked=finite,
    threshold_db=finite,
    noise_std_db=non_negative,
    discount=share,
    max_steps=st.none() | st.integers(1, 10**7),
    start=cells,
    goal=cells,
)
learners = st.builds(
    DDQNHERVariants,
    episodes=count,
    batch_size=count,
    replay_capacity=st.integers(10**6, 10**8),
    replay_start=st.integers(1, 10**6),
    updates_per_episode=count,
    target_period=count,
    learning_rate=positive,
    exploration=st.sampled_from(["boltzmann", "epsilon-greedy"]),
    initial_exploration=st.floats(0, 1),
    final_exploration=st.floats(0, 1),
    exploration_fraction=share,
    hindsight=st.booleans(),
    hindsight_ratio=count,
    hindsight_strategy=st.sampled_from(["future", "final", "episode"]),
    double=st.booleans(),
    clip_targets=st.booleans(),
    architecture=st.sampled_from(["concatenated", "two-stream", "dueling"]),
    hidden_layers=count,
    hidden_units=count,
    n_steps=st.integers(1, 100),
    prioritised=st.booleans(),
    priority_exponent=st.floats(0.01, 1),
    importance_exponent=st.floats(0, 1),
    networks=st.integers(1, 2),
)
evaluations = st.builds(
    EvaluationSettings,
    n_sampled=st.integers(1, 10**7),
    seed=st.integers(0, 2**40),
    boltzmann_temperature=st.floats(min_value=0, max_value=1e6, exclude_min=True),
    max_exhaustive_pairs=st.integers(0, 10**12),
)
scenarios = st.builds(
    Scenario,
    name=names,
    map=simulated | measured | st.builds(MapFile, path=paths),
    task=tasks,
    learner=learners,
    evaluation=evaluations,
)


@pytest.fixture(scope="session")
def scenario_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Where a scenario may be written, again and again."""
    return tmp_path_factory.mktemp("scenario") / "scenario.toml"


@given(scenario=scenarios)
def test_what_is_dumped_loads_equal(scenario_file: Path, scenario: Scenario) -> None:
    scenario_file.write_text(dump_scenario(scenario), encoding="utf-8")
    assert load_scenario(scenario_file) == scenario


def test_a_dump_is_the_same_after_a_round_trip(scenario_file: Path) -> None:
    text = dump_scenario(load_scenario(find_scenario("thesis-3d")))
    scenario_file.write_text(text, encoding="utf-8")
    assert dump_scenario(load_scenario(scenario_file)) == text


def test_the_name_of_a_scenario_is_that_of_its_file_unless_it_says_otherwise(tmp_path: Path) -> None:
    (tmp_path / "hill.toml").write_text("[learner]\nepisodes = 5\n")
    assert load_scenario(tmp_path / "hill.toml").name == "hill"


def test_integers_serve_where_a_number_is_expected(tmp_path: Path) -> None:
    (tmp_path / "a.toml").write_text("[map]\nheights_m = [30]\nbin_m = 20\nx_range_m = [-200, 200]\n[task]\nrho_goal = 10\n")
    assert load_scenario(tmp_path / "a.toml") == Scenario(name="a")


@pytest.mark.parametrize(
    ("text", "line", "field"),
    [
        ("map.bin_m = -1.0\n", 1, "map.bin_m"),
        ("name = 'x'\nmap = { bin_m = -1.0 }\n", 2, "map.bin_m"),
        ("[ map ] # the map\n# bin_m = 3\nheights_m = [\n  30.0,\n]\n  bin_m = -1.0 # [m]\n", 6, "map.bin_m"),
        ("[task]\nmax_steps = 10\n[map]\nbin_m = -1.0\n", 4, "map.bin_m"),
        ("[evaluation]\nseed = 3\n[task]\nseed = 3\n", 4, "task.seed"),
        ("\n\n[task]\ndiscount = 2.0\n[learner]\nepisodes = 1\n", 4, "task.discount"),
        ("[task]\nrho_goal = true\n", 2, "task.rho_goal"),
        ("[learner]\nepisodes = '10'\n", 2, "learner.episodes"),
        ("[learner]\nhindsight = 1\n", 2, "learner.hindsight"),
        ("[map]\nkind = 'measured'\nbin_m = 0.0\n", 3, "map.bin_m"),
        ("[map]\nkind = 'measured'\nheights_m = [30.0]\n", 3, "map.heights_m"),
        ("[map]\nheights_m = [30.0, 'x']\n", 2, "map.heights_m"),
    ],
)
def test_what_is_wrong_is_named_by_file_line_and_field(tmp_path: Path, text: str, line: int, field: str) -> None:
    file = tmp_path / "wrong.toml"
    file.write_text(text)
    with pytest.raises(InputError) as refused:
        load_scenario(file)
    message = str(refused.value)
    assert message.startswith(f"{file}:{line}: ")
    assert field in message
    assert "\n" not in message


def test_eight_scenarios_ship() -> None:
    thesis, exact = {"thesis-2d", "thesis-2d-noise", "thesis-3d"}, {"exact-2d", "exact-2d-noise", "exact-3d"}
    assert {path.stem for path in SHIPPED.glob("*.toml")} == {"quick", "ukm-30m"} | thesis | exact


@pytest.mark.parametrize("name", ["2d", "2d-noise", "3d"])
def test_the_exact_scenarios_differ_from_the_thesis_in_the_learner_alone(name: str) -> None:
    exact, thesis = (load_scenario(find_scenario(f"{kind}-{name}")) for kind in ("exact", "thesis"))
    assert (exact.map, exact.task, exact.evaluation) == (thesis.map, thesis.task, thesis.evaluation)
    assert exact.learner.algorithm == "fqi-her"


def test_a_setting_of_the_other_learner_is_unknown(tmp_path: Path) -> None:
    file = tmp_path / "mixed.toml"
    file.write_text('[learner]\nalgorithm = "fqi-her"\nepisodes = 10\n')
    with pytest.raises(InputError, match=r"mixed.toml:3: unknown key learner.episodes"):
        load_scenario(file)
    file.write_text('[learner]\nalgorithm = "fqi-her"\nnear = 0.7\nprioritised = 0.4\n')
    with pytest.raises(InputError, match="add up to more than 1"):
        load_scenario(file)


THESIS_2D = {"heights_m": (30.0,), "noise_std_db": 0.0, "episodes": 30_000, "exploration_fraction": 0.5}
THESIS = {
    "thesis-2d": THESIS_2D,
    "thesis-2d-noise": THESIS_2D | {"noise_std_db": 2.0},
    "thesis-3d": {
        "heights_m": (20.0, 40.0, 60.0, 80.0, 100.0),
        "noise_std_db": 2.0,
        "episodes": 50_000,
        "exploration_fraction": 0.7,
    },
}


@pytest.mark.parametrize("name", THESIS)
def test_the_scenarios_of_the_thesis_differ_from_the_defaults_only_where_it_says_so(name: str) -> None:
    scenario = load_scenario(find_scenario(name))
    values = THESIS[name]
    expected = Scenario(
        name=name,
        map=SimulatedMap(heights_m=values["heights_m"]),
        task=TaskSettings(noise_std_db=values["noise_std_db"]),
        learner=DDQNHER(episodes=values["episodes"], exploration_fraction=values["exploration_fraction"]),
    )
    assert scenario == expected


def test_the_defaults_are_the_thesis() -> None:
    simulated, task, learner = SimulatedMap(), TaskSettings(), DDQNHER()
    # Table 4.1 and section 4.2.1
    assert (simulated.rings, simulated.power_dbm, simulated.inter_site_distance_m) == (1, 48.0, 500.0)
    assert (simulated.carrier_hz, simulated.bandwidth_hz, simulated.base_height_m) == (2e9, 10e6, 25.0)
    assert (simulated.bin_m, simulated.x_range_m, simulated.y_range_m) == (20.0, (-200.0, 200.0), (-200.0, 200.0))
    # Table 4.2 and section 4.4.2
    assert (task.rho_goal, task.rho_sinr, task.rho_step, task.threshold_db) == (10.0, -1.0, -0.1, 3.0)
    assert (task.start, task.goal, task.max_steps) == (None, None, None)
    # Table 4.3 and section 4.3
    assert (learner.batch_size, learner.replay_capacity, learner.replay_start) == (32, 500_000, 50_000)
    assert (learner.target_period, task.discount, learner.learning_rate) == (10, 0.995, 1e-3)
    assert (learner.initial_exploration, learner.final_exploration, learner.explores_by) == (2.0, 0.1, "temperature")
    assert (learner.updates_per_episode, learner.hindsight_ratio) == (30, 2)
    assert (learner.hidden_layers, learner.hidden_units) == (3, 50)
    assert EvaluationSettings().n_sampled == 10_000


def test_the_measured_scenario() -> None:
    scenario = load_scenario(find_scenario("ukm-30m"))
    assert isinstance(scenario.map, MeasuredMap)
    assert (scenario.map.bin_m, scenario.map.fill_radius_m, scenario.task.threshold_db) == (40.0, 80.0, -3.0)
    assert scenario.map.logs == ()


def test_the_quick_scenario_is_smaller_than_the_exact_one() -> None:
    quick, exact = (load_scenario(find_scenario(name)) for name in ("quick", "exact-2d"))
    assert (quick.task, quick.evaluation) == (exact.task, exact.evaluation)
    assert quick.map.bin_m > exact.map.bin_m
    assert quick.learner.rounds < exact.learner.rounds


@pytest.mark.parametrize("name", ["quick", "ukm-30m"])
def test_what_users_start_from_trains_the_near_exact_learner(name: str) -> None:
    assert load_scenario(find_scenario(name)).learner.algorithm == "fqi-her"
