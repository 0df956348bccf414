"""Every verb on a tiny experiment, from the scenario to the report."""

import json
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from cli_tools import BRIEF_FLAGS, Cli, strict_json

from cellpilot import __version__
from cellpilot.cli.main import VERBS
from cellpilot.maps import load_map
from cellpilot.scenario import load_scenario

RUN_FILES = {
    "scenario.toml",
    "map.nc",
    "run.json",
    "state.safetensors",
    "train.nc",
    "policy.safetensors",
    "eval.nc",
    "report.html",
}
POLICIES = ["greedy", "optimal", "optimal-undiscounted", "learned/argmax", "learned/boltzmann-0.1"]
METRICS = {
    "reached_share",
    "low_sinr_share",
    "path_ratio_p50",
    "path_ratio_p90",
    "return_mean",
    "return_ci95",
    "regret_mean",
    "score",
    "longest_outage_p90_steps",
    "longest_outage_p90_s",
    "handovers_per_km",
    "ping_pong_share",
    "links_lost_per_km",
    "serving_loss_mean_db",
    "altitude_share",
}


@pytest.fixture
def log(place: Path) -> Path:
    """The synthetic log that ships with the package, at 30 m."""
    (place / "30m.csv").write_bytes(files("cellpilot").joinpath("data", "synthetic_30m.csv").read_bytes())
    return place / "30m.csv"


def test_run_makes_map_policy_evaluation_and_report(place: Path, cli: Cli) -> None:
    result = cli("run", "tiny.toml", "--out", "new", "--seed", "3", "--learner.episodes", "40")
    assert result.code == 0, result.err
    run = place / "new"
    assert {path.name for path in run.iterdir()} >= RUN_FILES
    assert "new/report.html" in result.out
    for name in ("greedy", "optimum", "arg max"):
        assert name in result.out
    facts = strict_json((run / "run.json").read_text())
    assert facts["seed"] == 3
    assert facts["updates"] == 40 * 30
    assert facts["env_steps"] >= 40
    assert facts["train_wall_s"] > 0
    assert facts["compile_s"] > 0
    assert facts["versions"]["cellpilot"] == __version__
    assert load_scenario(run / "scenario.toml").learner.episodes == 40
    page = (run / "report.html").read_text()
    assert "http://" not in page.replace("http://www.w3.org", "")
    assert 'src="data:' in page or "<svg" in page
    assert str(place) not in (run / "run.json").read_text()


def test_run_on_a_measured_log_trains_the_near_exact_learner(log: Path, place: Path, cli: Cli) -> None:
    few = (*BRIEF_FLAGS, "--evaluation.n-sampled", "50")
    result = cli("run", "ukm-30m", "--map.logs", "30m.csv", "--map.bin-m", "120", *few, "--out", "new")
    assert result.code == 0, result.err
    assert {path.name for path in (place / "new").iterdir()} >= RUN_FILES
    assert load_map(place / "new" / "map.nc").attrs["source"] == "measured log"
    page = (place / "new" / "report.html").read_text()
    assert "<dt>learner</dt><dd>fqi-her</dd>" in page
    y, x = np.nonzero(load_map(place / "new" / "map.nc")["blocked_reason"].values[0] == 0)
    places = ("--start", f"{x[0]},{y[0]},0", "--goal", f"{x[-1]},{y[-1]},0")
    route = strict_json(cli("plan", "new", *places, "--policy", "learned", "--json").out)
    assert route["policy"] == "learned/argmax"
    assert strict_json(cli("evaluate", "new", "--json").out)["policies"].keys() == set(POLICIES)


def test_evaluate_prints_nothing_but_json(place: Path, cli: Cli) -> None:
    result = cli("evaluate", "run", "--json")
    assert result.code == 0, result.err
    found = strict_json(result.out)
    assert found["scenario"] == "tiny"
    assert found["exhaustive"] is True
    for part in ("policies", "sampled"):
        assert list(found[part]) == POLICIES
        for metrics in found[part].values():
            assert set(metrics) >= METRICS
    low, high = found["sampled"]["greedy"]["return_ci95"]
    assert low <= found["sampled"]["greedy"]["return_mean"] <= high
    optimal, learned = found["policies"]["optimal"], found["policies"]["learned/argmax"]
    assert optimal["reached_share"] == 1
    assert optimal["regret_mean"] == 0
    # Random weights fly in circles: failures must not end in NaN or Infinity.
    assert learned["reached_share"] < 0.5
    assert learned["regret_mean"] > 0
    assert (place / "run" / "eval.nc").is_file()


def test_handovers_where_the_map_knows_every_sector(place: Path, cli: Cli) -> None:
    row = strict_json(cli("evaluate", "run", "--json").out)["policies"]["greedy"]
    assert row["handovers_per_km"] > 0
    scenario = place / "run" / "scenario.toml"
    assert "hysteresis_db = 3.0" in scenario.read_text()
    scenario.write_text(scenario.read_text().replace("hysteresis_db = 3.0", "hysteresis_db = 60.0"))
    stubborn = strict_json(cli("evaluate", "run", "--json").out)["policies"]["greedy"]
    assert stubborn["handovers_per_km"] == 0
    assert stubborn["serving_loss_mean_db"] > row["serving_loss_mean_db"]
    unknown = strict_json(cli("evaluate", "run", "--map", "plain.nc", "--json").out)["policies"]["greedy"]
    assert unknown["handovers_per_km"] is None
    assert unknown["longest_outage_p90_s"] == unknown["longest_outage_p90_steps"] * 10.0  # 100 m at 10 m/s


def test_the_second_table_of_evaluate_tells_of_handovers(place: Path, cli: Cli) -> None:
    told = cli("evaluate", "run").out
    assert "sampled flights at 10 m/s" in told
    row = strict_json(cli("evaluate", "run", "--json").out)["policies"]["greedy"]
    line = next(line for line in told.split("handovers/km")[1].splitlines() if "greedy" in line)
    assert f"{row['handovers_per_km']:.2f}" in line


def test_run_on_a_map_file_instead_of_the_scenarios_own(place: Path, cli: Cli) -> None:
    result = cli("run", "tiny.toml", "--map", "plain.nc", "--out", "new", "--learner.episodes", "40")
    assert result.code == 0, result.err
    assert load_map(place / "new" / "map.nc").equals(load_map(place / "plain.nc"))
    assert load_scenario(place / "new" / "scenario.toml").map.path == Path("plain.nc")
    assert load_scenario(place / "new" / "scenario.toml").name == "tiny-on-plain"  # published figures are of another map


def test_evaluate_without_the_exhaustive_part(place: Path, cli: Cli) -> None:
    assert cli("map", "simulate", "tiny.toml", "--out", "map.nc").code == 0
    scenario = place / "run" / "scenario.toml"
    scenario.write_text(scenario.read_text().replace("max_exhaustive_pairs = 5000000", "max_exhaustive_pairs = 10"))
    found = strict_json(cli("evaluate", "run", "--json").out)
    assert found["exhaustive"] is False
    assert found["policies"] == found["sampled"]


def test_evaluate_on_another_map_writes_nothing(place: Path, cli: Cli) -> None:
    before = {path.name for path in (place / "run").iterdir()}
    own, other = (strict_json(cli("evaluate", "run", *m, "--json").out) for m in ([], ["--map", "plain.nc"]))
    assert own["policies"]["greedy"] != other["policies"]["greedy"]
    assert {path.name for path in (place / "run").iterdir()} - before == {"eval.nc"}


def test_the_table_of_evaluate_names_every_policy(place: Path, cli: Cli) -> None:
    result = cli("evaluate", "run")
    assert result.code == 0
    for word in ("greedy", "optimum", "arg max", "pairs"):
        assert word in result.out


def test_report_evaluates_first_if_needed(trained: Path, cli: Cli) -> None:
    result = cli("report", "trained")
    assert result.code == 0, result.err
    assert "trained/report.html" in result.out
    assert (trained / "report.html").stat().st_size > 10_000
    assert (trained / "eval.nc").is_file()


@pytest.mark.parametrize("policy", ["optimal", "greedy", "learned"])
def test_plan_prints_nothing_but_json(place: Path, cli: Cli, policy: str) -> None:
    result = cli("plan", "run", "--start", "0,0,0", "--goal", "3,2,0", "--policy", policy, "--json")
    route = strict_json(result.out)
    assert result.code == (0 if route["status"] == "reached" else 1)
    steps = np.array([step["position"] for step in route["steps"]])
    assert steps[0].tolist() == [0, 0, 0]
    assert route["n_steps"] == len(steps) - 1
    assert route["shortest_steps"] == 5
    assert (np.abs(np.diff(steps, axis=0)).sum(1) <= 1).all()
    radio_map = load_map(place / "run" / "map.nc")
    for step in route["steps"]:
        ix, iy, iz = step["position"]
        assert step["sinr_db"] == pytest.approx(float(radio_map["sinr_db"][iz, iy, ix]), abs=1e-4)
        assert step["x_m"] == pytest.approx(float(radio_map["x"][ix]))
        assert step["low_probability"] == float(step["sinr_db"] < 5.0)
    if policy == "learned":
        assert route["status"] in ("reached", "loops", "time limit")
    else:
        assert route["status"] == "reached"
        assert steps[-1].tolist() == [3, 2, 0]
    if policy == "greedy":
        assert route["n_steps"] == 5


def test_plan_on_a_map_file_needs_no_training_and_avoids_what_is_bad(place: Path, cli: Cli) -> None:
    # plain.nc: the row iy = 2 lies below the threshold, so a route from corner to corner crosses it once.
    places = ("--start", "0,0,0", "--goal", "3,3,0")
    route = strict_json(cli("plan", "plain.nc", *places, "--json").out)
    assert sum(step["low_probability"] for step in route["steps"]) == 1
    assert route["expected_return"] == pytest.approx(10 - 6 * 0.1 - 1)
    text = cli("plan", "plain.nc", *places)
    assert text.code == 0
    assert "reached after 6 steps" in text.out
    free = strict_json(cli("plan", "plain.nc", *places, "--task.rho-sinr", "0", "--task.rho-goal", "5", "--json").out)
    assert free["expected_return"] == pytest.approx(5 - 6 * 0.1)


def test_plan_in_metres_equals_plan_in_cells(place: Path, cli: Cli) -> None:
    cells = cli("plan", "plain.nc", "--start", "0,0,0", "--goal", "3,3,0", "--json")
    metres = cli("plan", "plain.nc", "--start=-150m,-150m,30m", "--goal", "160m,140m,30m", "--json")
    assert metres.code == 0, metres.err
    assert metres.out == cells.out


def test_plan_around_a_blocked_cell(place: Path, cli: Cli) -> None:
    for policy in ("optimal", "greedy"):
        route = strict_json(cli("plan", "blocked.nc", "--start", "0,1,0", "--goal", "2,1,0", "--policy", policy, "--json").out)
        assert route["shortest_steps"] == route["n_steps"] == 4
        assert [1, 1, 0] not in [step["position"] for step in route["steps"]]


def test_plan_by_latitude_and_longitude_on_a_measured_map(log: Path, place: Path, cli: Cli) -> None:
    assert cli("map", "import", "30m.csv", "--out", "measured.nc", "--unknown", "bad").code == 0
    cells = cli("plan", "measured.nc", "--start", "2,3,0", "--goal", "7,6,0", "--json")
    assert cells.code == 0, cells.err
    steps = strict_json(cells.out)["steps"]
    first, last = (",".join(f"{step[k]:.7f}" for k in ("latitude_deg", "longitude_deg")) for step in (steps[0], steps[-1]))
    degrees = cli("plan", "measured.nc", f"--start={first},30.0", f"--goal={last},30.0", "--json")
    assert degrees.code == 0, degrees.err
    assert degrees.out == cells.out


def test_plan_names_a_route_that_does_not_arrive(place: Path, cli: Cli) -> None:
    result = cli("plan", "plain.nc", "--start", "0,0,0", "--goal", "3,3,0", "--task.max-steps", "3")
    assert result.code == 1
    assert "time limit after 3 steps" in result.out


def test_map_simulate_and_info(place: Path, cli: Cli) -> None:
    result = cli("map", "simulate", "tiny.toml", "--out", "deep/new.nc", "--map.heights-m", "30", "60", "--map.bin-m", "80")
    assert result.code == 0, result.err
    assert "deep/new.nc" in result.out
    text = cli("map", "info", "deep/new.nc", "--threshold-db", "5").out
    assert "5 x 5 x 2 cells" in text
    assert "30 m: 25 free cells" in text
    assert "60 m: 25 free cells" in text


def test_map_import_and_info(log: Path, place: Path, cli: Cli) -> None:
    higher = place / "50m.csv"
    higher.write_bytes(files("cellpilot").joinpath("data", "synthetic_50m.csv").read_bytes())
    result = cli("map", "import", "30m.csv", "50m.csv", "--out", "new.nc")
    assert result.code == 0, result.err
    assert "SINR samples kept" in result.out
    radio_map = load_map(place / "new.nc")
    assert radio_map["z"].values.tolist() == [30.0, 50.0]
    text = cli("map", "info", "new.nc").out
    assert "30 m:" in text
    assert "50 m:" in text
    assert "mask:" in text
    other = cli("map", "import", "30m.csv", "--altitude", "44", "--out", "other.nc", "--fill-radius-m", "0", "--mask", "none")
    assert other.code == 0, other.err
    assert load_map(place / "other.nc")["z"].values.tolist() == [44.0]
    assert not load_map(place / "other.nc")["filled"].any()


def test_the_order_of_the_rows_changes_nothing(log: Path, place: Path, cli: Cli) -> None:
    header, *rows = log.read_text().splitlines()
    (place / "shuffled").mkdir()
    shuffled = [rows[i] for i in np.random.default_rng(0).permutation(len(rows))]
    (place / "shuffled" / "30m.csv").write_text("\n".join([header, *shuffled, ""]))
    for source, out in (("30m.csv", "a.nc"), ("shuffled/30m.csv", "b.nc")):
        assert cli("map", "import", source, "--out", out).code == 0
    assert load_map(place / "a.nc").equals(load_map(place / "b.nc"))


@pytest.mark.shared
def test_the_real_log_imports_and_plans(place: Path, cli: Cli) -> None:
    log = Path(__file__).parents[3] / "shared" / "data" / "ukm" / "30m.csv"
    assert cli("map", "import", log, "--out", "real.nc", "--unknown", "bad").code == 0
    result = cli("plan", "real.nc", "--start", "0,0,0", "--goal", "3,3,0", "--task.threshold-db", "-3", "--json")
    assert result.code == 0, result.err
    assert strict_json(result.out)["status"] == "reached"


@pytest.mark.parametrize(("suffix", "magic"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("svg", b"<?xml")])
def test_map_show_draws(place: Path, cli: Cli, suffix: str, magic: bytes) -> None:
    result = cli("map", "show", "plain.nc", "--out", f"picture.{suffix}")
    assert result.code == 0, result.err
    assert (place / f"picture.{suffix}").read_bytes().startswith(magic)
    assert f"picture.{suffix}" in result.out


def test_map_show_draws_beside_the_map_if_not_told_where(place: Path, cli: Cli) -> None:
    assert cli("map", "show", "plain.nc").code == 0
    assert (place / "plain.png").is_file()


def test_a_file_name_is_printed_as_it_is(place: Path, cli: Cli) -> None:
    assert "a[bold]map[0].nc" in cli("map", "simulate", "tiny.toml", "--out", "a[bold]map[0].nc").out


@pytest.mark.parametrize(
    ("threshold_db", "words"),
    [("-20", ["0.0%", "-20 dB", "higher"]), ("15", ["100.0%", "15 dB", "lower"]), ("5", [])],
)
def test_a_threshold_that_nearly_all_or_none_miss_is_warned_of(
    place: Path, cli: Cli, threshold_db: str, words: list[str]
) -> None:
    places = ("--start", "0,0,0", "--goal", "3,3,0", "--json")
    calls = (
        ("map", "info", "plain.nc", "--threshold-db", threshold_db),
        ("plan", "plain.nc", *places, "--task.threshold-db", threshold_db),
    )
    for call in calls:
        result = cli(*call)
        assert result.code == 0
        assert ("warning:" in result.err) == bool(words)
        assert all(word in result.err for word in words)
        assert "warning" not in result.out


def test_evaluate_warns_of_the_threshold_of_the_map_it_flies_on(place: Path, cli: Cli) -> None:
    import xarray as xr

    radio_map = load_map(place / "plain.nc")
    radio_map["sinr_db"] = xr.full_like(radio_map["sinr_db"], 40.0)
    from cellpilot.maps import save_map

    save_map(radio_map, place / "perfect.nc")
    assert "warning" not in cli("evaluate", "run", "--json").err
    result = cli("evaluate", "run", "--map", "perfect.nc", "--json")
    assert "only 0.0% of the cells lie below 5 dB" in result.err
    strict_json(result.out)


def test_doctor_finds_everything_in_order(cli: Cli) -> None:
    result = cli("doctor", "--verbose")
    assert result.code == 0, result.out
    assert "FAIL" not in result.out
    assert __version__ in result.out
    assert "thesis-2d" in result.out


@pytest.mark.parametrize("flag", ["-h", "--help"])
def test_help_of_the_program_lists_every_verb(cli: Cli, flag: str) -> None:
    result = cli(flag)
    assert result.code == 0
    assert all(f"  {verb} " in result.out for verb in VERBS)
    assert cli().out == result.out


def test_version(cli: Cli) -> None:
    assert cli("--version").out.strip() == f"cellpilot {__version__}"


@pytest.mark.parametrize(
    ("verb", "words"),
    [
        (["run"], ["--task.noise-std-db", "[dB]", "default: 50000", "Table 4.3", "--seed", "--map.shadowing-seed", "--resume"]),
        (["train"], ["--learner.episodes", "default: 30000", "Table 4.3", "Table 4.1", "[Hz]"]),
        (["map"], ["simulate", "import", "info", "show"]),
        (["map", "simulate"], ["--map.bin-m", "[m]", "default: 20.0", "Table 4.1"]),
        (["map", "import"], ["--altitude", "[m]", "default: 40.0", "--mask"]),
        (["map", "info"], ["--threshold-db", "[dB]", "default: 3.0"]),
        (["map", "show"], ["--threshold-db", "[dB]", "--out"]),
        (["evaluate"], ["--json", "--map"]),
        (["report"], ["run folder"]),
        (["plan"], ["--start", "--goal", "--policy", "metres", "Table 4.2", "default: 3.0"]),
        (["ablation"], ["--seeds", "default: 5", "Table 4.3"]),
        (["sensitivity"], ["--learned", "Table 4.2"]),
        (["doctor"], ["--verbose"]),
    ],
    ids=lambda value: " ".join(value) if value and len(value) < 3 else "",
)
def test_help_shows_units_defaults_and_tables(cli: Cli, verb: list[str], words: list[str]) -> None:
    for flag in ("--help", "-h"):
        result = cli(*verb, flag)
        assert result.code == 0
        assert result.err == ""
        text = " ".join(result.out.replace("│", " ").replace("|", " ").split())
        assert [word for word in words if word not in text] == []


def test_help_after_a_scenario_shows_the_values_of_that_scenario(place: Path, cli: Cli) -> None:
    text = " ".join(cli("run", "tiny.toml", "--help").out.replace("│", " ").split())
    assert "default: 100.0" in text
    assert "default: 60)" in text


def test_every_setting_of_a_scenario_is_a_flag_of_run(cli: Cli) -> None:
    from cellpilot.scenario import Scenario

    text = cli("run", "--help").out
    for section in ("map", "task", "learner", "evaluation"):
        for name, field in type(getattr(Scenario(), section)).model_fields.items():
            flag = f"--{section}.{'no-' if field.default is True else ''}{name.replace('_', '-')}"
            assert (flag in text) != (name == "kind"), flag


def test_a_flag_overrides_the_file_and_the_file_overrides_the_default(place: Path, cli: Cli) -> None:
    flags = (
        "--learner.algorithm",
        "ddqn-her-variants",
        "--learner.no-hindsight",
        "--task.noise-std-db",
        "2",
        "--learner.episodes",
        "5",
        "--learner.replay-start",
        "50",
    )
    assert cli("train", "tiny.toml", "--out", "new", *flags).code == 0
    scenario = load_scenario(place / "new" / "scenario.toml")
    assert (scenario.learner.hindsight, scenario.task.noise_std_db, scenario.learner.episodes) == (False, 2.0, 5)
    assert (scenario.map.bin_m, scenario.task.rho_goal) == (100.0, 10.0)
    assert json.loads((place / "new" / "run.json").read_text())["updates"] == 5 * 30
