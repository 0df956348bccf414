"""The examples run, small."""

import re
import runpy
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from cellpilot.maps import make_map, save_map

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def sb3_her() -> Callable[[list[str]], int]:
    """The example's `main`."""
    pytest.importorskip("stable_baselines3")
    return runpy.run_path(str(EXAMPLES / "sb3_her.py"))["main"]


def test_sb3_learns_to_reach_goals_on_a_tiny_map(
    sb3_her: Callable[[list[str]], int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    x_m, y_m = np.arange(4) * 20.0, np.arange(3) * 20.0
    save_map(make_map(np.linspace(0, 9, 12).reshape(1, 3, 4), x_m=x_m, y_m=y_m, z_m=[30.0], source="test"), tmp_path / "map.nc")
    call = ["--env", "cellpilot/RadioMap-v0", "--map-file", str(tmp_path / "map.nc"), "--steps", "1500", "--flights", "30"]
    assert sb3_her([*call, "--out", str(tmp_path / "model.zip")]) == 0
    rows = re.findall(r"([\d.]+)% of 30 goals reached, mean return +(\S+)", capsys.readouterr().out)
    (_, random_return), (learned_share, learned_return) = ([float(figure) for figure in row] for row in rows)
    assert (tmp_path / "model.zip").stat().st_size > 1000
    assert learned_share > 60
    assert learned_return > random_return + 2


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["--env", "cellpilot/Thesis4D-v0"], "Thesis4D"),
        (["--env", "cellpilot/RadioMap-v0"], "map_file"),
        (["--env", "cellpilot/RadioMap-v0", "--map-file", "gone.nc"], "gone.nc"),
    ],
)
def test_a_wrong_environment_is_one_line(
    sb3_her: Callable[[list[str]], int], capsys: pytest.CaptureFixture[str], arguments: list[str], named: str
) -> None:
    assert sb3_her(arguments) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith("sb3_her: ")
    assert named in line


@pytest.mark.parametrize("arguments", [["--steps", "0"], ["--flights", "-3"], ["--seed", "-1"]])
def test_wrong_numbers_are_refused(sb3_her: Callable[[list[str]], int], arguments: list[str]) -> None:
    with pytest.raises(SystemExit) as stop:
        sb3_her(arguments)
    assert stop.value.code == 2
