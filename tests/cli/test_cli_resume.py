"""A killed or interrupted training goes on to exactly the result of an uninterrupted one."""

import json
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_tools import Cli, assert_refused, tree
from safetensors.numpy import load_file

from cellpilot.storage import LOCK, TEMPORARY

WRAPPER = """
import os, signal, sys
from cellpilot.learn import checkpoint, trainer
from cellpilot.learn.compiled import CompiledProgram
from cellpilot.cli.main import main

moment, n = sys.argv[1], int(sys.argv[2])
trainer.train_many.__wrapped__.__kwdefaults__.update(checkpoint_every_s=0.0, chunk_rounds=7)
count = 0

def reached(what):
    global count
    count += what == moment
    return what == moment and count == n

save_state, save_tensors, run_chunk = trainer.save_state, checkpoint.save_tensors, CompiledProgram.run

def save_and_stop(*arguments):
    save_state(*arguments)
    if reached("after a checkpoint"):
        os.kill(os.getpid(), signal.SIGKILL)

def cut_and_stop(descriptor):
    os.ftruncate(descriptor, 1000)
    os.kill(os.getpid(), signal.SIGKILL)

def half_save_and_stop(*arguments):
    if reached("while a checkpoint is written"):
        os.fsync = cut_and_stop
    save_tensors(*arguments)

def run_and_stop(program, packed, n_rounds):
    done = run_chunk(program, packed, n_rounds)
    if reached("between two checkpoints"):
        os.kill(os.getpid(), signal.SIGKILL)
    if reached("Ctrl-C"):
        os.kill(os.getpid(), signal.SIGINT)
    return done

trainer.save_state, checkpoint.save_tensors, CompiledProgram.run = save_and_stop, half_save_and_stop, run_and_stop
sys.exit(main(sys.argv[3:]))
"""
"""Kills or interrupts its own process at the n-th occurrence of a moment, with a checkpoint after every 7 flights."""

CALL = ("train", "tiny.toml", "--out", "cut", "--seed", "7")


def stop_at(moment: str, n: int, place: Path) -> subprocess.CompletedProcess[str]:
    """Train in another process until the moment."""
    command = [sys.executable, "-c", WRAPPER, moment, str(n), *CALL]
    return subprocess.run(command, cwd=place, capture_output=True, text=True, timeout=300, check=False)


def assert_same_result(one: Path, other: Path) -> None:
    """Parameters and learning curves equal bit for bit; files complete."""
    a, b = (load_file(run / "policy.safetensors") for run in (one, other))
    assert a.keys() == b.keys()
    for name in a:
        assert a[name].tobytes() == b[name].tobytes(), name
    import xarray as xr

    with xr.open_dataset(one / "train.nc", engine="h5netcdf") as c, xr.open_dataset(other / "train.nc", engine="h5netcdf") as d:
        assert c.identical(d)
    facts = [json.loads((run / "run.json").read_text()) for run in (one, other)]
    assert facts[0]["env_steps"] == facts[1]["env_steps"]
    assert facts[0]["updates"] == facts[1]["updates"] == 60 * 30


@pytest.mark.parametrize(
    ("moment", "n", "leaves_checkpoint"),
    [
        ("between two checkpoints", 1, False),
        ("after a checkpoint", 3, True),
        ("while a checkpoint is written", 5, True),
    ],
)
def test_a_killed_training_resumes_to_the_uninterrupted_result(
    trained: Path, place: Path, cli: Cli, moment: str, n: int, leaves_checkpoint: bool
) -> None:
    killed = stop_at(moment, n, place)
    assert killed.returncode == -signal.SIGKILL, killed.stderr
    run = place / "cut"
    assert (run / "state.safetensors").is_file() == leaves_checkpoint
    assert not (run / "policy.safetensors").exists()
    result = cli("train", "--resume", "cut")
    assert result.code == 0, result.err
    assert_same_result(trained, run)
    assert {path.name for path in run.iterdir()} == {path.name for path in trained.iterdir()}, "a temporary file was left"


def test_ctrl_c_says_how_to_resume_and_resumes_to_the_uninterrupted_result(trained: Path, place: Path, cli: Cli) -> None:
    stopped = stop_at("Ctrl-C", 2, place)
    assert stopped.returncode == 130, stopped.stderr
    assert "Traceback" not in stopped.stderr
    assert "--resume cut" in stopped.stderr
    assert "14 episodes" in stopped.stderr
    assert not (place / "cut" / "policy.safetensors").exists()
    assert cli("train", "--resume", "cut").code == 0
    assert_same_result(trained, place / "cut")


def test_a_leftover_of_a_kill_does_not_stop_force(place: Path, cli: Cli) -> None:
    (place / "run" / f"{TEMPORARY}01234567-state.safetensors").write_bytes(b"half")
    (place / "run" / LOCK).write_text("99999999\n")
    result = cli("train", "tiny.toml", "--out", "run", "--force", "--map.heights-m", "400")
    assert_refused(result, "400")


def test_what_a_kill_left_of_a_run_that_had_not_begun_counts_as_nothing(place: Path, cli: Cli) -> None:
    few = ("--learner.episodes", "5", "--learner.replay-start", "100")
    for left in ([], ["run.json"], ["run.json", "map.nc"]):
        for path in (place / "run").iterdir():
            if path.name not in left:
                path.unlink()
        (place / "run" / f"{TEMPORARY}01234567-map.nc").write_bytes(b"half")
        assert cli("train", "tiny.toml", "--out", "run", *few).code == 0
    # A map alone is somebody's map.
    for path in (place / "run").iterdir():
        if path.name != "map.nc":
            path.unlink()
    assert_refused(cli("train", "tiny.toml", "--out", "run"), "run is not empty")


def test_force_leaves_a_persons_own_files_in_the_folders_of_a_run(trained: Path, cli: Cli) -> None:
    for name in ("figures/mine.png", "figures/training.png", "tensorboard/notes.txt", "tensorboard/events.out"):
        (trained / name).parent.mkdir(exist_ok=True)
        (trained / name).write_text("x")
    assert cli("train", "tiny.toml", "--out", "trained", "--force", "--learner.episodes", "5").code == 0
    assert [p.name for p in sorted((trained / "figures").iterdir())] == ["mine.png"]
    assert (trained / "tensorboard" / "notes.txt").is_file()
    assert not (trained / "tensorboard" / "events.out").exists()


def test_resuming_a_finished_training_changes_no_result(trained: Path, place: Path, cli: Cli) -> None:
    shutil.copytree(trained, place / "again")
    assert cli("train", "--resume", "again").code == 0
    assert_same_result(trained, place / "again")


def test_a_truncated_checkpoint_is_refused_and_kept(trained: Path, cli: Cli) -> None:
    checkpoint = trained / "state.safetensors"
    (trained / "policy.safetensors").unlink()
    checkpoint.write_bytes(checkpoint.read_bytes()[:-100])
    before = tree(trained)
    assert_refused(cli("train", "--resume", "trained"), "state.safetensors")
    assert tree(trained) == before


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("episodes = 60", "episodes = 70"),
        ("threshold_db = 5.0", "threshold_db = 4.0"),
        ("hindsight_ratio = 2", "hindsight_ratio = 3"),
    ],
)
def test_a_checkpoint_of_other_settings_is_refused(trained: Path, cli: Cli, old: str, new: str) -> None:
    scenario = trained / "scenario.toml"
    assert old in scenario.read_text()
    scenario.write_text(scenario.read_text().replace(old, new))
    before = tree(trained)
    assert_refused(cli("train", "--resume", "trained"), "state.safetensors", "another")
    assert tree(trained) == before


def test_same_seed_same_policy_another_seed_another_policy(trained: Path, place: Path, cli: Cli) -> None:
    assert cli("train", "tiny.toml", "--out", "same", "--seed", "7").code == 0
    assert cli("train", "tiny.toml", "--out", "other", "--seed", "8").code == 0
    assert_same_result(trained, place / "same")
    metrics = [cli("evaluate", run, "--json").out for run in ("trained", "same", "other")]
    assert metrics[0] == metrics[1]
    assert metrics[0] != metrics[2]
    a, b = (load_file(run / "policy.safetensors") for run in (trained, place / "other"))
    assert all(not np.array_equal(a[name], b[name]) for name in a)
