"""`--seeds N`: every seed a complete run folder, one table over all, interrupted and resumed together."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cli_tools import Cli, assert_refused
from safetensors.numpy import load_file

from cellpilot.cli import devices

FEW = ("--learner.episodes", "12", "--learner.replay-start", "100", "--learner.updates-per-episode", "2")


def returns(run: Path) -> np.ndarray:
    """The learning curve of a run."""
    with xr.open_dataset(run / "train.nc", engine="h5netcdf") as dataset:
        return np.asarray(dataset["episode_return"].values)


def test_every_seed_is_a_complete_run(place: Path, cli: Cli) -> None:
    result = cli("train", "tiny.toml", "--out", "many", "--seed", "6", "--seeds", "2", *FEW)
    assert result.code == 0, result.err
    assert cli("train", "tiny.toml", "--out", "one", "--seed", "7", *FEW).code == 0
    runs = [place / "many-seed6", place / "many-seed7"]
    assert not (place / "many").exists()
    for seed, run in zip((6, 7), runs, strict=True):
        assert {path.name for path in run.iterdir()} == {path.name for path in (place / "one").iterdir()}
        assert json.loads((run / "run.json").read_text())["seed"] == seed
    np.testing.assert_allclose(returns(runs[1]), returns(place / "one"), atol=1e-4)
    assert (returns(runs[0]) != returns(runs[1])).any()
    policies = [load_file(run / "policy.safetensors") for run in (*runs, place / "one")]
    for name, tensor in policies[1].items():
        np.testing.assert_allclose(tensor, policies[2][name], atol=1e-4)
        assert (tensor != policies[0][name]).any()
    last = [curve[-1] for curve in map(returns, runs)]  # the last tenth of twelve flights is one
    assert "mean ± standard deviation over 2 seeds" in result.out
    assert f"{np.mean(last):.3f} ± {np.std(last, ddof=1):.3f}" in result.out
    assert cli("train", "--resume", *map(str, runs)).code == 0  # nothing left to do
    assert cli("evaluate", "many-seed6").code == 0


def test_run_evaluates_each_and_shows_the_spread(place: Path, cli: Cli) -> None:
    result = cli("run", "tiny.toml", "--out", "many", "--seeds", "2", *FEW, "--evaluation.n-sampled", "20")
    assert result.code == 0, result.err
    assert all((place / f"many-seed{seed}" / name).is_file() for seed in (0, 1) for name in ("eval.nc", "report.html"))
    row = next(line for line in result.out.splitlines() if "greedy" in line)
    reached, *_ = re.findall(r"(\d+\.\d+) ± (\d+\.\d+)", row)
    assert reached == ("100.000", "0.000")


def test_an_occupied_folder_stops_all_before_any_is_made(place: Path, cli: Cli) -> None:
    (place / "many-seed1").mkdir()
    (place / "many-seed1" / "precious.txt").write_text("mine")
    assert_refused(cli("train", "tiny.toml", "--out", "many", "--seeds", "2", *FEW), "many-seed1")
    assert not (place / "many-seed0").exists()


@pytest.mark.parametrize("other", [("--seed", "6", "--task.threshold-db", "4"), ("--seed", "5")])
def test_only_runs_that_differ_in_their_seed_alone_resume_together(place: Path, cli: Cli, other: tuple[str, ...]) -> None:
    assert cli("train", "tiny.toml", "--out", "a", "--seed", "5", *FEW).code == 0
    assert cli("train", "tiny.toml", "--out", "b", *other, *FEW).code == 0
    assert_refused(cli("train", "--resume", "a", "b"), "b" if len(other) > 2 else "5, 5")


def test_each_core_becomes_a_device_only_where_nobody_has_decided_yet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "sched_getaffinity", lambda pid: {0, 1, 2}, raising=False)
    for set_before, imported, n_seeds, expected in (
        (None, False, 2, "--xla_force_host_platform_device_count=2"),
        (None, False, 9, "--xla_force_host_platform_device_count=3"),
        (None, False, 1, None),
        (None, True, 9, None),
        ("--mine", False, 9, "--mine"),
    ):
        monkeypatch.delenv("XLA_FLAGS", raising=False)
        if set_before:
            monkeypatch.setenv("XLA_FLAGS", set_before)
        modules = {name: module for name, module in sys.modules.items() if name != "jax"} | ({"jax": os} if imported else {})
        monkeypatch.setattr(devices.sys, "modules", modules)
        devices.use_all_cores(n_seeds)
        assert os.environ.get("XLA_FLAGS") == expected


def test_the_command_line_trains_on_several_devices(place: Path) -> None:
    """In a process of its own, where JAX has not been imported yet."""
    code = "import sys; from cellpilot.cli.main import main; code = main(sys.argv[1:])"
    code += "; import jax; print(jax.local_device_count(), code)"
    command = [sys.executable, "-c", code, "train", "tiny.toml", "--out", "many", "--seeds", "2", *FEW]
    environment = {name: value for name, value in os.environ.items() if name != "XLA_FLAGS"}
    done = subprocess.run(command, cwd=place, env=environment, capture_output=True, text=True, timeout=300, check=False)
    n_cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    assert done.stdout.splitlines()[-1] == f"{min(2, n_cores or 1)} 0", done.stderr
