"""Numbers do not depend on what JAX is told elsewhere, and where it cannot compute that is one line."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

CALL = "import sys; from cellpilot.cli.main import main; sys.exit(main())"
SCENARIO = """\
name = "tiny"
[map]
heights_m = [30.0]
bin_m = 100.0
points_per_side = 2
"""
FEW = {
    "ddqn-her": ("--learner.episodes", "8", "--learner.replay-start", "100", "--learner.updates-per-episode", "2"),
    "fqi-her": ("--learner.algorithm", "fqi-her", "--learner.rounds", "3", "--learner.updates-per-round", "5"),
}


def train(place: Path, learner: str, out: str, **environment: str) -> subprocess.CompletedProcess[str]:
    """A short training in a process of its own."""
    (place / "tiny.toml").write_text(SCENARIO)
    command = [sys.executable, "-c", CALL, "train", "tiny.toml", *FEW[learner], "--out", out]
    surroundings = os.environ | environment
    return subprocess.run(command, cwd=place, env=surroundings, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("learner", FEW)
def test_double_precision_elsewhere_changes_no_number(tmp_path: Path, learner: str) -> None:
    for out, wide in (("narrow", "0"), ("wide", "1")):
        ended = train(tmp_path, learner, out, JAX_ENABLE_X64=wide)
        assert ended.returncode == 0, ended.stderr
    narrow, wide = ((tmp_path / out / "policy.safetensors").read_bytes() for out in ("narrow", "wide"))
    assert narrow == wide


@pytest.mark.parametrize(
    ("environment", "named"),
    [({"JAX_PLATFORMS": "cuda"}, "JAX_PLATFORMS=cuda"), ({"JAX_DISABLE_JIT": "1"}, "JAX_DISABLE_JIT")],
)
def test_a_backend_that_is_not_there_is_one_line(tmp_path: Path, environment: dict[str, str], named: str) -> None:
    ended = train(tmp_path, "fqi-her", "out", **environment)
    assert ended.returncode == 2
    line = ended.stderr.splitlines()[-1]
    assert line.startswith("cellpilot: ")
    assert named in line
    assert "Traceback" not in ended.stderr
