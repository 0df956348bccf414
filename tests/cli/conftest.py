"""A tiny experiment, as files, as a run folder without training, and trained once per process."""

import shutil
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from cli_tools import TINY, Cli, Result

from cellpilot.cli.main import main
from cellpilot.maps import make_map, save_map
from cellpilot.policies import PolicyParameters
from cellpilot.policies.learned import save_parameters
from cellpilot.runs import create_run
from cellpilot.scenario import load_scenario


@pytest.fixture
def cli(capsys: pytest.CaptureFixture[str]) -> Cli:
    """Call the command line in this process."""

    def call(*arguments: str | Path) -> Result:
        capsys.readouterr()
        try:
            code = main([str(argument) for argument in arguments])
        except SystemExit as stop:
            code = stop.code if isinstance(stop.code, int) else int(stop.code is not None)
        captured = capsys.readouterr()
        return Result(code, captured.out, captured.err)

    return call


@pytest.fixture(scope="session")
def _template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("template")
    (folder / "tiny.toml").write_text(TINY)
    coordinates = np.arange(4) * 100.0 - 150
    sinr_db = np.full((1, 4, 4), 10.0)
    sinr_db[0, 2] = -5.0
    blocked = np.zeros((1, 4, 4), bool)
    blocked[0, 1, 1] = True
    save_map(make_map(sinr_db, x_m=coordinates, y_m=coordinates, z_m=[30.0], source="test"), folder / "plain.nc")
    wall = make_map(sinr_db, x_m=coordinates, y_m=coordinates, z_m=[30.0], source="test", blocked_reason=blocked)
    save_map(wall, folder / "blocked.nc")
    larger = np.arange(5) * 100.0
    larger_db = np.full((1, 5, 5), 10.0)
    larger_db[0, 2] = -5.0
    save_map(make_map(larger_db, x_m=larger, y_m=larger, z_m=[30.0], source="test"), folder / "larger.nc")
    run = create_run(folder / "run", load_scenario(folder / "tiny.toml"), 0, "test")
    rng = np.random.default_rng(0)
    # Small, so that the values stay within what a flight can earn.
    tensors = {}
    for i, (n_in, n_out) in enumerate(pairwise((4, 50, 50, 50, 4))):
        tensors[f"network.layers.{i}.weight"] = 0.1 * rng.normal(size=(n_out, n_in)).astype(np.float32)
        tensors[f"network.layers.{i}.bias"] = 0.1 * rng.normal(size=n_out).astype(np.float32)
    save_parameters(PolicyParameters(tensors, "concatenated", (4, 4, 1)), run.policy_file)
    return folder


@pytest.fixture
def place(_template: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: tiny.toml, three maps, and a run folder with a policy of random weights."""
    shutil.copytree(_template, tmp_path, dirs_exist_ok=True)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="session")
def _trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("trained")
    (folder / "tiny.toml").write_text(TINY)
    assert main(["train", str(folder / "tiny.toml"), "--out", str(folder / "trained"), "--seed", "7"]) == 0
    return folder / "trained"


@pytest.fixture
def trained(_trained: Path, place: Path) -> Path:
    """A finished, uninterrupted training with seed 7, copied into the working directory."""
    return Path(shutil.copytree(_trained, place / "trained"))
