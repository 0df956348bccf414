"""A result knows what it was made from, and one command at a time works in a folder."""

import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cli_tools import TINY, Cli, assert_refused, strict_json, tree

from cellpilot.maps import load_map, save_map
from cellpilot.policies import load_parameters
from cellpilot.policies.learned import save_parameters
from cellpilot.report.figures import FIGURES
from cellpilot.runs import FIGURE_STEMS, load_evaluation, open_run, stale_parts
from cellpilot.storage import LOCK, hold

COMMAND = (sys.executable, "-c", "import sys; from cellpilot.cli.main import main; sys.exit(main())")
FEW = ("--learner.episodes", "12", "--learner.replay-start", "100", "--learner.updates-per-episode", "2")


def start(place: Path, *arguments: str) -> subprocess.Popen[str]:
    """A command in a process of its own."""
    return subprocess.Popen([*COMMAND, *arguments], cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_figures_of_a_report_are_those_that_a_run_folder_calls_its_own() -> None:
    assert tuple(FIGURES) == FIGURE_STEMS


def test_a_report_after_more_training_shows_the_policy(trained: Path, cli: Cli) -> None:
    # As after an interrupted run: evaluated without a policy, then trained to the end.
    (trained / "policy.safetensors").rename(trained / "aside")
    assert cli("report", "trained").code == 0
    assert "arg max" not in (trained / "report.html").read_text()
    (trained / "aside").rename(trained / "policy.safetensors")
    result = cli("report", "trained")
    assert result.code == 0, result.err
    assert "another policy: evaluating again" in result.err
    assert "arg max" in (trained / "report.html").read_text()
    assert cli("report", "trained").err == ""


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("threshold_db = 5.0", "threshold_db = 4.0", "task"),
        ("n_sampled = 100", "n_sampled = 90", "evaluation settings"),
        ("speed_mps = 10.0", "speed_mps = 12.0", "evaluation settings"),
    ],
)
def test_an_evaluation_names_what_has_changed_since(place: Path, cli: Cli, old: str, new: str, part: str) -> None:
    assert cli("evaluate", "run").code == 0
    assert stale_parts(open_run("run")) == []
    scenario = place / "run" / "scenario.toml"
    assert old in scenario.read_text()
    scenario.write_text(scenario.read_text().replace(old, new))
    assert stale_parts(open_run("run")) == [part]


def test_an_evaluation_knows_its_policy_map_and_version(place: Path, cli: Cli) -> None:
    assert stale_parts(open_run("run")) is None
    assert cli("evaluate", "run").code == 0
    parameters = load_parameters(place / "run" / "policy.safetensors")
    parameters.tensors["network.layers.0.bias"][3] += 1e-3
    save_parameters(parameters, place / "run" / "policy.safetensors")
    assert stale_parts(open_run("run")) == ["policy"]
    radio_map = load_map(place / "run" / "map.nc")
    radio_map["sinr_db"][0, 1, 2] += 0.01
    save_map(radio_map, place / "run" / "map.nc")
    assert stale_parts(open_run("run")) == ["policy", "map"]
    data = load_evaluation(place / "run")
    made = json.loads(data.attrs["made_from"])
    assert made.keys() == {"policy", "map", "task", "evaluation settings", "version of cellpilot"}
    data.attrs["made_from"] = json.dumps(made | {"version of cellpilot": "0.0.1"})
    data.to_netcdf(place / "run" / "eval.nc", engine="h5netcdf")
    assert stale_parts(open_run("run")) == ["policy", "map", "version of cellpilot"]
    # Of a version that did not say.
    del data.attrs["made_from"]
    data.to_netcdf(place / "run" / "eval.nc", engine="h5netcdf")
    assert len(stale_parts(open_run("run")) or []) == 5


def test_a_map_of_another_run_is_said_by_evaluate_and_refused_by_report(trained: Path, cli: Cli) -> None:
    radio_map = load_map(trained / "map.nc")
    radio_map["sinr_db"] += 1.0
    save_map(radio_map, trained / "map.nc")
    assert "trained with another map" in cli("evaluate", "trained").err
    assert_refused(cli("report", "trained"), "another map", "restore")


def test_the_page_of_a_report_carries_the_digests(place: Path, cli: Cli) -> None:
    assert cli("report", "run").code == 0
    made = json.loads(load_evaluation(place / "run").attrs["made_from"])
    page = (place / "run" / "report.html").read_text()
    assert all(digest in page for digest in made.values())


def test_numbers_that_cannot_be_saved_are_printed(place: Path, cli: Cli) -> None:
    (place / "run" / "eval.nc").mkdir()
    result = cli("evaluate", "run", "--json")
    assert result.code == 0
    assert strict_json(result.out)["policies"]
    assert "warning: the evaluation was not saved" in result.err
    assert "eval.nc" in result.err


def test_a_shipped_policy_is_evaluated_without_a_folder(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch) -> None:
    import cellpilot.runs.folder as folder

    shipped = place / "shipped"
    shipped.mkdir()
    (shipped / "tiny.toml").write_text(TINY)
    shutil.copy(place / "run" / "policy.safetensors", shipped / "tiny.safetensors")
    monkeypatch.setattr(folder, "SHIPPED", shipped)
    monkeypatch.setattr(folder, "find_scenario", lambda name: shipped / f"{name}.toml")
    before = tree(place)
    assert "learned/argmax" in strict_json(cli("evaluate", "tiny", "--json").out)["policies"]
    assert tree(place) == before
    for _ in range(2):
        assert cli("report", "tiny").code == 0
    assert {path.name for path in (place / "runs").iterdir()} == {"tiny-shipped"}
    assert (place / "runs" / "tiny-shipped" / "report.html").is_file()


@pytest.mark.parametrize("name", ["policy.safetensors", "map.nc", "eval.nc", "scenario.toml"])
def test_an_export_does_not_overwrite_the_run(place: Path, cli: Cli, name: str) -> None:
    before = tree(place)
    assert_refused(cli("export", "run", "--onnx", f"run/{name}"), "overwritten", "--onnx")
    assert_refused(cli("export", f"run/{name}", "--onnx", f"run/../run/{name}"), "overwritten", "--onnx")
    assert tree(place) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("train", "tiny.toml", "--out", "run", "--force"),
        ("run", "tiny.toml", "--out", "run", "--force"),
        ("train", "--resume", "run"),
        ("report", "run"),
        ("ablation", "tiny.toml", "--out", "run"),
        ("sensitivity", "tiny.toml", "--out", "run"),
    ],
)
def test_a_folder_in_use_is_left_alone_and_the_process_is_named(place: Path, cli: Cli, arguments: tuple[str, ...]) -> None:
    before = tree(place / "run")
    with hold(place / "run"):
        result = cli(*arguments)
    assert_refused(result, "run is in use by process", str(os.getpid()))
    assert tree(place / "run") == before


def test_evaluate_of_one_run_twice_at_once(place: Path) -> None:
    both = [start(place, "evaluate", "run", "--json") for _ in range(2)]
    said = [process.communicate(timeout=120) for process in both]
    assert [process.returncode for process in both] == [0, 0], said
    assert said[0][0] == said[1][0]
    assert not [path.name for path in (place / "run").iterdir() if path.name.startswith(".")]
    assert stale_parts(open_run(place / "run")) == []


def test_of_two_trainings_on_one_folder_one_trains_and_one_says_who(place: Path) -> None:
    calls = [("train", "tiny.toml", "--out", "both", "--seed", str(seed), *FEW) for seed in (0, 1)]
    both = [start(place, *call) for call in calls]
    said = [process.communicate(timeout=300)[1] for process in both]
    codes = sorted(process.returncode for process in both)
    assert codes == [0, 2], said
    loser = next(i for i in (0, 1) if both[i].returncode == 2)
    assert f"both is in use by process {both[1 - loser].pid}" in said[loser] or "both is not empty" in said[loser]
    run = open_run(place / "both")
    parameters = run.parameters()
    assert parameters is not None
    assert parameters.about["seed"] == run.seed == 1 - loser
    with xr.open_dataset(place / "both" / "train.nc", engine="h5netcdf") as data:
        assert data.attrs["seed"] == run.seed


def test_a_killed_training_leaves_a_lock_that_the_next_one_takes_over(place: Path, cli: Cli) -> None:
    process = start(place, "train", "tiny.toml", "--out", "cut", *FEW)
    lock = place / "cut" / LOCK
    while not lock.is_file() or not lock.read_text():
        assert process.poll() is None
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert lock.exists()
    assert cli("train", "tiny.toml", "--out", "cut", *FEW).code == 0
    assert not lock.exists()


@pytest.mark.parametrize(
    ("entry", "value"),
    [
        ("train_wall_s", "x"),
        ("updates", [1]),
        ("env_steps", -1),
        ("seed", 2**31),
        ("seed", True),
        ("seed", None),
        ("versions", {"numpy": 2}),
        ("command", ["cellpilot"]),
        ("compile_s", float("nan")),
    ],
)
def test_a_wrong_entry_of_run_json_is_one_line(place: Path, cli: Cli, entry: str, value: object) -> None:
    path = place / "run" / "run.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {entry: value}))
    for call in (("report", "run"), ("train", "--resume", "run")):
        assert_refused(cli(*call), "run.json", entry)


def test_run_json_nested_too_deeply_is_one_line(place: Path, cli: Cli) -> None:
    (place / "run" / "run.json").write_text("[" * 100_000)
    assert_refused(cli("report", "run"), "run.json", "nested")


def test_evaluations_are_equal_before_and_after_being_saved(place: Path, cli: Cli) -> None:
    printed = strict_json(cli("evaluate", "run", "--json").out)
    data = load_evaluation(place / "run")
    assert json.loads(data.attrs["metrics"]) == printed
    assert np.isfinite(data["drawn_return"]).all()


def test_the_numbers_of_a_run_are_printed_even_where_they_cannot_be_saved(trained: Path, cli: Cli) -> None:
    (trained / "eval.nc").mkdir()
    result = cli("run", "--resume", "trained")
    assert result.code == 2
    assert "arg max" in result.out
    assert "eval.nc: cannot be written" in result.err.splitlines()[-1]
