"""Wrong input: exit code 2, one line that names the thing, and every file as it was before."""

import json
import shutil
from importlib.resources import files
from pathlib import Path

import jax
import pytest
from cli_tools import TINY, Cli, assert_refused, tree

from cellpilot import memory
from cellpilot.cli.main import VERBS
from cellpilot.envs.arena import make_arena
from cellpilot.learn.algorithms.ddqn_her_settings import EXPERIENCE_BYTES, DDQNHERVariants
from cellpilot.learn.algorithms.fqi_her import initial_state
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.learn.replay import init_replay
from cellpilot.maps import load_map, save_map
from cellpilot.scenario import LEARNERS
from cellpilot.world import World

LOG_HEADER = "Time,Latitude,Longitude,RSRP (LTE pcell),RS SNR"
PLACES = ("--start", "0,0,0", "--goal", "3,3,0")
VARIANTS = ("--learner.algorithm", "ddqn-her-variants")

FILES = {
    "empty.toml": "",
    "comment.toml": "# nothing but a comment\n",
    "syntax.toml": "[map]\nheights_m = [30.0\n",
    "unknown.toml": "[map]\nheights_m = [30.0]\n\nbinm = 3.0\n",
    "section.toml": "name = 'x'\n[lerner]\nepisodes = 10\n",
    "type.toml": '[map]\nheights_m = [30.0]\nbin_m = "wide"\n',
    "integer.toml": "[learner]\n# half a flight\nepisodes = 10.5\n",
    "number.toml": "[map]\nheights_m = 30.0\n",
    "table.toml": "\nmap = 3\n",
    "kind.toml": '[map]\nkind = "guessed"\n',
    "choice.toml": '[learner]\nalgorithm = "ddqn-her-variants"\nexploration = "none"\n',
    "sigma.toml": "[task]\nrho_goal = 1.0\nnoise_std_db = -2.0\n",
    "episodes.toml": "[learner]\nepisodes = 0\n",
    "nan.toml": "[task]\nrho_goal = nan\n",
    "memory.toml": "[learner]\nreplay_capacity = 100\n",
    "epsilon.toml": '[learner]\nalgorithm = "ddqn-her-variants"\nexploration = "epsilon-greedy"\n',
    "position.toml": "[task]\nstart = [0, 0]\n",
    "text.csv": "hello\nworld\n",
    "empty_30m.csv": "",
    "header_30m.csv": LOG_HEADER + "\n",
    "nosinr_30m.csv": "Time,Latitude,Longitude,RSRP (LTE pcell)\n1,0.01,0.01,-80\n2,0.02,0.02,-81\n",
    "blank_30m.csv": LOG_HEADER + "\n1,0.01,0.01,-80,\n2,0.02,0.02,-81,\n",
    "latitude_30m.csv": LOG_HEADER + "\n1,0.01,0.01,,5\n2,91.5,0.02,,6\n3,0.03,0.01,,5\n",
    "word_30m.csv": LOG_HEADER + "\n1,0.01,0.01,,5\n2,0.02,0.02,,good\n3,0.03,0.01,,5\n",
    "noheight.csv": LOG_HEADER + "\n1,0.01,0.01,,5\n2,0.02,0.02,,6\n",
    "empty.nc": "",
    "text.nc": "this is no map\n",
}

TOML = [
    ("gone.toml", ["gone.toml", "no such"]),
    ("empty.toml", ["empty.toml", "empty"]),
    ("comment.toml", ["comment.toml", "empty"]),
    ("syntax.toml", ["syntax.toml", "TOML"]),
    ("unknown.toml", ["unknown.toml:4", "map.binm"]),
    ("section.toml", ["section.toml:2", "lerner"]),
    ("type.toml", ["type.toml:3", "map.bin_m", "wide"]),
    ("integer.toml", ["integer.toml:3", "learner.episodes", "10.5"]),
    ("number.toml", ["number.toml:2", "map.heights_m", "30.0"]),
    ("table.toml", ["table.toml:2", "map", "3"]),
    ("kind.toml", ["kind.toml:", "guessed", "simulated"]),
    ("choice.toml", ["choice.toml:3", "learner.exploration", "none", "boltzmann"]),
    ("sigma.toml", ["sigma.toml:3", "task.noise_std_db", "-2"]),
    ("episodes.toml", ["episodes.toml:2", "learner.episodes", "0"]),
    ("nan.toml", ["nan.toml:2", "task.rho_goal", "nan"]),
    ("memory.toml", ["memory.toml:", "replay_start", "100"]),
    ("epsilon.toml", ["epsilon.toml:", "initial_exploration"]),
    ("position.toml", ["position.toml:2", "task.start"]),
]

FLAGS = [
    (["--task.noise-std-db", "-1"], ["--task.noise-std-db", "-1"]),
    (["--task.noise-std-db=-1"], ["--task.noise-std-db", "-1"]),
    (["--task.rho-goal", "nan"], ["--task.rho-goal", "nan"]),
    (["--task.discount", "1.5"], ["--task.discount", "1.5"]),
    (["--task.max-steps", "0"], ["--task.max-steps", "0"]),
    (["--learner.episodes", "0"], ["--learner.episodes", "0"]),
    (["--learner.episodes", "ten"], ["--learner.episodes", "ten"]),
    (["--learner.learning-rate", "0"], ["--learner.learning-rate", "0"]),
    ([*VARIANTS, "--learner.exploration", "none"], ["--learner.exploration", "none", "boltzmann"]),
    ([*VARIANTS, "--learner.exploration", "epsilon-greedy"], ["initial_exploration"]),
    (["--learner.replay-capacity", "100"], ["replay_capacity", "100", "replay_start", "200"]),
    (["--learner.replay-capacity", "239"], ["replay_capacity", "239", "240"]),
    (["--learner.replay-capacity", "10000000000000"], ["replay"]),
    (["--map.environment", "moon"], ["--map.environment", "moon", "UMa-AV"]),
    (["--map.bin-m", "400"], ["1 cell"]),
    (["--map.bin-m", "0"], ["--map.bin-m", "0"]),
    (["--map.load", "1.5"], ["--map.load", "1.5"]),
    (["--map.heights-m", "400"], ["height", "400"]),
    (["--map.heights-m", "1"], ["height", "1"]),
    (["--map.heights-m", "60", "30"], ["heights", "60", "30"]),
    (["--map.x-range-m", "200", "-200"], ["200", "-200"]),
    (["--map.logs", "30m.csv"], ["--map.logs"]),
    (["--task.start", "0", "0", "0", "--task.goal", "0", "0", "0"], ["start", "goal", "(0, 0, 0)"]),
    (["--task.start", "9", "0", "0"], ["start", "(9, 0, 0)"]),
    (["--task.goal", "0", "-1", "0"], ["goal", "(0, -1, 0)"]),
    (["--seed", "-1"], ["--seed", "-1"]),
    (["--seed", "5000000000"], ["seed", "5000000000"]),
    (["--seed", "one"], ["--seed", "one"]),
    (["--speed", "3"], ["--speed"]),
    (["tiny.toml"], ["tiny.toml"]),
    (["--map", "gone.nc"], ["gone.nc", "no such file"]),
    (["--map"], ["--map", "expected one map file"]),
    (["--map", "plain.nc", "--map.bin-m", "3"], ["--map.bin-m"]),
]

LOGS = [
    (["gone_30m.csv"], ["gone_30m.csv", "no such file"]),
    (["gone.csv"], ["gone.csv", "no such file"]),
    (["text.csv", "--altitude", "30"], ["text.csv", "Latitude"]),
    (["empty_30m.csv"], ["empty_30m.csv", "empty"]),
    (["header_30m.csv"], ["header_30m.csv", "RS SNR"]),
    (["nosinr_30m.csv"], ["nosinr_30m.csv", "RS SNR"]),
    (["blank_30m.csv"], ["blank_30m.csv", "RS SNR"]),
    (["latitude_30m.csv"], ["latitude_30m.csv", "line 3", "Latitude", "91.5"]),
    (["word_30m.csv"], ["word_30m.csv", "line 3", "RS SNR", "good"]),
    (["noheight.csv"], ["noheight.csv", "--altitude"]),
    (["30m.csv", "--altitude", "-3"], ["--altitude", "-3"]),
    (["30m.csv", "--bin-m", "0"], ["--bin-m", "0"]),
    (["30m.csv", "--bin-m", "0.001"], ["0.001"]),
    (["30m.csv", "--fill-radius-m", "-1"], ["--fill-radius-m", "-1"]),
    (["30m.csv", "--mask", "here"], ["--mask", "here"]),
    (["30m.csv", "--mask", "95", "0", "25"], ["latitude", "95"]),
    (["30m.csv", "--unknown", "good"], ["--unknown", "good", "blocked"]),
    (["30m.csv", "30m.csv"], ["30m.csv", "twice"]),
    ([], ["log"]),
]

CALLS = [
    (["fly-me"], ["fly-me", "plan"]),
    (["run"], ["scenario"]),
    (["train"], ["scenario"]),
    (["ablation"], ["scenario"]),
    (["sensitivity"], ["scenario"]),
    (["run", "--out", "new"], ["scenario"]),
    (["run", "gone"], ["gone", "thesis-2d"]),
    (["ablation", "tiny.toml", "--seeds", "0"], ["--seeds", "0"]),
    (["ablation", "quick", "--out", "new"], ["quick", "fqi-her", "--learner.algorithm ddqn-her"]),
    (["train", "quick", "--learner.episodes", "3", "--out", "new"], ["--learner.episodes", "ddqn-her", "quick", "fqi-her"]),
    (["run", "quick", "--learner.no-hindsight", "--out", "new"], ["--learner.no-hindsight", "ddqn-her-variants"]),
    (["train", "tiny.toml", "--learner.rounds=3", "--out", "new"], ["--learner.rounds", "fqi-her", "tiny", "ddqn-her"]),
    (["train", "tiny.toml", "--seeds", "0"], ["--seeds", "0"]),
    (["train", "tiny.toml", "--seed", "2147483647", "--seeds", "2"], ["--seeds 2"]),
    (["sensitivity", "gone.toml"], ["gone.toml"]),
    (["doctor", "--loud"], ["--loud"]),
    (["map", "draw"], ["draw", "simulate"]),
    (["map", "simulate"], ["scenario"]),
    (["map", "info"], ["RadioMap file"]),
    (["map", "info", "gone.nc"], ["gone.nc", "no such file"]),
    (["map", "info", "empty.nc"], ["empty.nc", "empty"]),
    (["map", "info", "text.nc"], ["text.nc", "NetCDF"]),
    (["map", "info", "foreign.nc"], ["foreign.nc", "RadioMap"]),
    (["map", "info", "."], ["."]),
    (["map", "info", "plain.nc", "--threshold-db", "nan"], ["--threshold-db", "nan"]),
    (["map", "show", "text.nc"], ["text.nc"]),
    (["map", "show", "plain.nc", "--out", "a.gif"], ["a.gif", ".png"]),
    (["run", "ukm-30m", "--out", "new"], ["--map.logs"]),
    (["run", "ukm-30m", "--map.logs", "gone_30m.csv", "--out", "new"], ["gone_30m.csv"]),
    (["evaluate"], ["run folder"]),
    (["evaluate", "gone"], ["gone", "no such run folder"]),
    (["evaluate", "here"], ["here", "scenario.toml"]),
    (["evaluate", "plain.nc"], ["plain.nc"]),
    (["evaluate", "run", "--map", "gone.nc"], ["gone.nc"]),
    (["evaluate", "run", "--map", "text.nc"], ["text.nc"]),
    (["evaluate", "run", "--map", "foreign.nc"], ["foreign.nc", "RadioMap"]),
    (["evaluate", "run", "--map", "larger.nc"], ["4 x 4 x 1", "5 x 5 x 1"]),
    (["evaluate", "run", "--mapp", "larger.nc"], ["--mapp"]),
    (["report"], ["run folder"]),
    (["report", "gone"], ["gone"]),
    (["report", "here"], ["here", "scenario.toml"]),
    (["train", "--resume", "gone"], ["gone", "no such run folder"]),
    (["run", "--resume", "gone"], ["gone", "no such run folder"]),
    (["train", "--resume", "here"], ["here", "scenario.toml"]),
    (["train", "--resume"], ["--resume"]),
    (["train", "--resume", "run", "--learner.episodes", "3"], ["--learner.episodes"]),
    (["evaluate", "run", "--map", "layers.nc"], ["4 x 4 x 1", "4 x 4 x 2"]),
    (["train", "--resume", "gone", "--tensorboard"], ["gone", "no such run folder"]),
    (["export"], ["run folder"]),
    (["export", "run"], ["--onnx"]),
    (["export", "run", "--onnx"], ["--onnx"]),
    (["export", "run", "--onnx", "here"], ["here", "folder"]),
    (["export", "gone", "--onnx", "new.onnx"], ["gone", "no such"]),
    (["export", "gone.safetensors", "--onnx", "new.onnx"], ["gone.safetensors", "no such file"]),
    (["export", "here", "--onnx", "new.onnx"], ["here", "scenario.toml"]),
    (["export", "plain.nc", "--onnx", "new.onnx"], ["plain.nc", "no such"]),
    (["export", "quick", "--onnx", "new.onnx"], ["quick", "trained policy"]),
    (["plan"], ["map file"]),
    (["plan", "gone.nc", *PLACES], ["gone.nc"]),
    (["plan", "text.nc", *PLACES], ["text.nc"]),
    (["plan", "text.csv", *PLACES], ["text.csv"]),
    (["plan", "here", *PLACES], ["here", "scenario.toml"]),
    (["plan", "plain.nc"], ["--start"]),
    (["plan", "plain.nc", "--start", "0,0,0"], ["--goal"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "0,0,0"], ["start", "goal", "(0, 0, 0)"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "4,0,0"], ["--goal", "4,0,0"]),
    (["plan", "plain.nc", "--start", "-1,0,0", "--goal", "1,0,0"], ["--start"]),
    (["plan", "plain.nc", "--start=-1,0,0", "--goal", "1,0,0"], ["--start", "-1,0,0"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "1,1"], ["--goal", "1,1"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "a,b,c"], ["--goal", "a,b,c"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "900m,0m,30m"], ["--goal", "900"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "100m,0m,nanm"], ["--goal", "nan"]),
    (["plan", "plain.nc", "--start", "0,0,0", "--goal", "2.9,101.7,30"], ["--goal", "anchor"]),
    (["plan", "blocked.nc", "--start", "1,1,0", "--goal", "3,3,0"], ["start", "(1, 1, 0)", "blocked"]),
    (["plan", "blocked.nc", "--start", "0,0,0", "--goal", "1,1,0"], ["goal", "(1, 1, 0)", "blocked"]),
    (["plan", "plain.nc", *PLACES, "--policy", "random"], ["--policy", "random", "greedy"]),
    (["plan", "plain.nc", *PLACES, "--policy", "learned"], ["plain.nc", "policy"]),
    (["plan", "plain.nc", *PLACES, "--task.noise-std-db", "-1"], ["--task.noise-std-db", "-1"]),
    (["plan", "ukm-30m", *PLACES], ["measured log"]),
]


def name_of(value: object) -> str | None:
    """The arguments themselves are the name of the case."""
    return " ".join(value) or "nothing" if isinstance(value, list) else None


@pytest.fixture
def desk(place: Path) -> Path:
    """The working directory with every kind of wrong file."""
    for name, text in FILES.items():
        (place / name).write_text(text)
    with files("cellpilot").joinpath("data", "synthetic_30m.csv").open("rb") as log:
        (place / "30m.csv").write_bytes(log.read())
    import xarray as xr

    xr.Dataset({"temperature": ("x", [1.0, 2.0])}).to_netcdf(place / "foreign.nc", engine="h5netcdf")
    low, high = load_map(place / "plain.nc"), load_map(place / "plain.nc").assign_coords(z=[60.0])
    save_map(xr.concat([low, high], "z", data_vars="minimal", combine_attrs="override"), place / "layers.nc")
    (place / "here").mkdir()
    (place / "here" / "notes.txt").write_text("mine")
    return place


@pytest.mark.parametrize(("file", "named"), TOML, ids=[file for file, _ in TOML])
def test_a_wrong_scenario_is_refused_with_file_line_and_field(desk: Path, cli: Cli, file: str, named: list[str]) -> None:
    before = tree(desk)
    for verb in (["run"], ["map", "simulate"]):
        assert_refused(cli(*verb, file, "--out", "new"), *named)
    assert tree(desk) == before


@pytest.mark.parametrize(("flags", "named"), FLAGS, ids=name_of)
def test_a_wrong_flag_is_refused_before_the_run_folder_exists(desk: Path, cli: Cli, flags: list[str], named: list[str]) -> None:
    before = tree(desk)
    assert_refused(cli("run", "tiny.toml", *flags, "--out", "new"), *named)
    assert tree(desk) == before


@pytest.mark.parametrize("flags", [["--map.bin-m", "400"], ["--task.start", "9", "0", "0"], ["--learner.replay-capacity", "239"]])
def test_a_refused_run_with_force_leaves_the_run_it_would_have_replaced(desk: Path, cli: Cli, flags: list[str]) -> None:
    before = tree(desk)
    assert_refused(cli("run", "tiny.toml", *flags, "--out", "run", "--force"))
    assert tree(desk) == before


@pytest.mark.parametrize(("arguments", "named"), LOGS, ids=name_of)
def test_a_wrong_log_leaves_no_map(desk: Path, cli: Cli, arguments: list[str], named: list[str]) -> None:
    before = tree(desk)
    assert_refused(cli("map", "import", *arguments, "--out", "new.nc"), *named)
    assert tree(desk) == before


@pytest.mark.parametrize(("arguments", "named"), CALLS, ids=name_of)
def test_a_wrong_call_is_refused(desk: Path, cli: Cli, arguments: list[str], named: list[str]) -> None:
    before = tree(desk)
    assert_refused(cli(*arguments), *named)
    assert tree(desk) == before


@pytest.mark.parametrize("kind", ["a file of mine", "a run", "a run and a file of mine", "a file"])
@pytest.mark.parametrize("verb", ["run", "train"])
def test_a_folder_that_is_not_empty_is_left_alone(desk: Path, cli: Cli, verb: str, kind: str) -> None:
    folder = {"a file of mine": "here", "a file": "text.csv"}.get(kind, "run")
    if kind == "a run and a file of mine":
        (desk / "run" / "thesis.tex").write_text("years of work")
    before = tree(desk)
    assert_refused(cli(verb, "tiny.toml", "--out", folder), folder, "--force" if kind == "a run" else "empty")
    if kind != "a run":
        assert_refused(cli(verb, "tiny.toml", "--out", folder, "--force"), folder)
    assert tree(desk) == before


def test_force_is_not_offered_where_it_does_not_help(desk: Path, cli: Cli) -> None:
    (desk / "run" / "thesis.tex").write_text("years of work")
    assert "--force" not in cli("run", "tiny.toml", "--out", "run", "--force").err


def test_a_study_does_not_mix_with_another_run(desk: Path, cli: Cli) -> None:
    before = tree(desk)
    assert_refused(cli("ablation", "tiny.toml", "--learner.episodes", "50", "--out", "run"), "run", "settings")
    assert_refused(cli("sensitivity", "tiny.toml", "--seed", "3", "--out", "run"), "run", "seed")
    assert_refused(cli("ablation", "tiny.toml", "--out", "here"), "here")
    assert tree(desk) == before


def damage(run: Path, how: str) -> str:
    """Damage a run folder; the name of the file that is wrong now."""
    name, action = how.split(" ", 1)
    file = run / name
    content = file.read_bytes() if file.exists() else (run / "policy.safetensors").read_bytes()
    replacement = {
        "missing": b"",
        "empty": b"",
        "truncated": content[: len(content) // 2],
        "text": b"this is something else\n",
        "list": b"[]\n",
        "without seed": b"{}\n",
        "text as seed": json.dumps({"seed": "zero"}).encode(),
        "unknown key": TINY.replace("bin_m", "binm").encode(),
        "of another kind": content,
    }[action]
    if action == "missing":
        file.unlink()
    else:
        file.write_bytes(replacement)
    return name


RUN_DAMAGE = [
    "scenario.toml missing",
    "scenario.toml empty",
    "scenario.toml unknown key",
    "run.json missing",
    "run.json empty",
    "run.json text",
    "run.json list",
    "run.json without seed",
    "run.json text as seed",
    "map.nc missing",
    "map.nc empty",
    "map.nc truncated",
    "map.nc text",
]
POLICY_DAMAGE = ["policy.safetensors empty", "policy.safetensors truncated", "policy.safetensors text"]
CHECKPOINT_DAMAGE = ["state.safetensors empty", "state.safetensors text", "state.safetensors of another kind"]


@pytest.mark.parametrize("how", RUN_DAMAGE)
def test_a_damaged_run_is_named(desk: Path, cli: Cli, how: str) -> None:
    name = damage(desk / "run", how)
    before = tree(desk)
    for call in (["evaluate", "run"], ["report", "run"], ["plan", "run", *PLACES], ["train", "--resume", "run"]):
        assert_refused(cli(*call), name)
    assert tree(desk) == before


@pytest.mark.parametrize("how", POLICY_DAMAGE)
def test_a_damaged_policy_is_named(desk: Path, cli: Cli, how: str) -> None:
    name = damage(desk / "run", how)
    before = tree(desk)
    for call in (["evaluate", "run"], ["report", "run"], ["plan", "run", *PLACES, "--policy", "learned"]):
        assert_refused(cli(*call), name)
    assert tree(desk) == before


@pytest.mark.parametrize("how", CHECKPOINT_DAMAGE)
@pytest.mark.parametrize("verb", ["train", "run"])
def test_a_damaged_checkpoint_is_named_and_kept(desk: Path, cli: Cli, verb: str, how: str) -> None:
    name = damage(desk / "run", how)
    before = tree(desk)
    assert_refused(cli(verb, "--resume", "run"), name)
    assert tree(desk) == before


@pytest.mark.parametrize(("map_file", "sides"), [("larger.nc", "5 x 5 x 1"), ("layers.nc", "4 x 4 x 2")])
def test_a_policy_of_another_grid_is_refused(desk: Path, cli: Cli, map_file: str, sides: str) -> None:
    shutil.copy(desk / map_file, desk / "run" / "map.nc")
    before = tree(desk)
    assert_refused(cli("plan", "run", *PLACES, "--policy", "learned"), "4 x 4 x 1", sides)
    assert_refused(cli("evaluate", "run"), "4 x 4 x 1", sides)
    assert tree(desk) == before


MAY_BE_NOTHING = {
    "optimism",
    "replan_every_steps",
    "prior_slope_std",
    "initial_exploration",
    "final_exploration",
    "importance_exponent",
    "prioritised",
    "near",
    "count_bonus",
}
"""Numbers of the learners that may be 0; no number may be negative."""
NUMBERS = [
    (algorithm, name, value)
    for algorithm, settings in LEARNERS.items()
    for name, field in settings.model_fields.items()
    if field.annotation in (int, float)
    for value in ("-1", "0")
    if not (value == "0" and name in MAY_BE_NOTHING)
]


@pytest.mark.parametrize(("algorithm", "name", "value"), NUMBERS)
def test_a_negative_or_zero_setting_of_a_learner_is_refused(desk: Path, cli: Cli, algorithm: str, name: str, value: str) -> None:
    flag = f"--learner.{name.replace('_', '-')}"
    call = ["train", "tiny.toml", "--learner.algorithm", algorithm, f"{flag}={value}", "--out", "new"]
    assert_refused(cli(*call), flag, value)
    assert not (desk / "new").exists()


@pytest.mark.parametrize(
    ("flag", "value"),
    [("networks", "3"), ("n-steps", "101"), ("n-steps", "1.5"), ("priority-exponent", "1.1"), ("importance-exponent", "nan"),
     ("architecture", "duelling")],
)  # fmt: skip
def test_a_switch_of_the_variants_beyond_its_range_is_refused(desk: Path, cli: Cli, flag: str, value: str) -> None:
    call = ("train", "tiny.toml", "--learner.algorithm", "ddqn-her-variants", f"--learner.{flag}={value}", "--out", "new")
    assert_refused(cli(*call), flag, value)
    assert not (desk / "new").exists()


@pytest.mark.parametrize("seeds", [1, 3])
def test_a_replay_larger_than_memory_is_refused_with_the_figure(
    desk: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, seeds: int
) -> None:
    needed = seeds * 20_000 * EXPERIENCE_BYTES
    monkeypatch.setattr(memory, "available_bytes", lambda: needed - 1)
    before = tree(desk)
    figures = (f"{needed / 1e9:.3g} GB", "20,000", "replay_capacity")
    assert_refused(cli("train", "tiny.toml", "--seeds", str(seeds), "--out", "new"), *figures)
    assert tree(desk) == before


@pytest.mark.parametrize(("n_steps", "prioritised"), [(1, False), (3, False), (1, True), (2, True)])
def test_the_figure_is_that_of_the_replay_memory(n_steps: int, prioritised: bool) -> None:
    replay = init_replay(1000, n_steps > 1, prioritised)
    leaves = jax.tree.leaves((replay.experiences, replay.priority))
    counted = DDQNHERVariants(n_steps=n_steps, prioritised=prioritised).experience_bytes
    assert sum(leaf.nbytes for leaf in leaves) == 1000 * counted
    assert (counted == EXPERIENCE_BYTES) == (n_steps == 1 and not prioritised)
    assert (memory.available_bytes() or 0) > 1e8


@pytest.mark.parametrize("seeds", [1, 3])
def test_targets_larger_than_memory_are_refused_with_the_figure(
    desk: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, seeds: int
) -> None:
    needed = seeds * FQIHER(cached_goals=10).kept_bytes((4, 4, 1))
    monkeypatch.setattr(memory, "available_bytes", lambda: needed - 1)
    before = tree(desk)
    call = ("train", "tiny.toml", "--learner.algorithm", "fqi-her", "--seeds", str(seeds), "--out", "new")
    figures = (f"{needed / 1e9:.3g} GB", "16 cells", "10 goals", "cached_goals")
    assert_refused(cli(*call, "--learner.cached-goals", "10"), *figures)
    assert tree(desk) == before


def test_the_ablation_counts_the_memories_of_all_its_seeds(desk: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(memory, "available_bytes", lambda: 3 * EXPERIENCE_BYTES * 500_000)
    before = tree(desk)
    call = ("ablation", "tiny.toml", "--learner.replay-capacity", "500000", "--out", "new")
    assert_refused(cli(*call, "--seeds", "4"), "500,000", "4 seeds", "GB")
    assert tree(desk) == before


@pytest.mark.parametrize("cached_goals", [7, 2000])
def test_the_figure_is_that_of_targets_and_tables(desk: Path, cached_goals: int) -> None:
    world = World.from_map(load_map(desk / "layers.nc"))
    settings = FQIHER(cached_goals=cached_goals, networks=2, hidden_units=3)
    state = initial_state(settings, make_arena(world), 0)
    tables = (state.online.table, state.average.table, state.optimizer.mu.table, state.optimizer.nu.table)
    kept = (state.cache.target, state.cache.error, state.cache.useful, *tables)
    assert sum(leaf.nbytes for leaf in kept) == settings.kept_bytes(world.grid.sides)


@pytest.mark.parametrize("verb", VERBS)
def test_an_unknown_flag_is_refused_by_every_verb(desk: Path, cli: Cli, verb: str) -> None:
    calls = {
        "map": ["map", "info", "plain.nc"],
        "adapt": ["adapt", "plain.nc", "blocked.nc"],
        "evaluate": ["evaluate", "run"],
        "report": ["report", "run"],
        "plan": ["plan", "plain.nc", *PLACES],
        "doctor": ["doctor"],
    }
    assert_refused(cli(*calls.get(verb, [verb, "tiny.toml"]), "--no-such-flag"), "--no-such-flag")


def test_the_scenario_is_the_argument_not_the_value_of_a_flag(desk: Path, cli: Cli) -> None:
    # A file named like a shipped scenario must not bring that scenario's settings along.
    assert cli("train", "--out", "quick", "tiny.toml").code == 0
    assert "4 x 4 x 1" in cli("map", "info", "quick/map.nc").out
