"""What the tests of the command line share."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

TINY = """\
name = "tiny"

[map]
heights_m = [30.0]
bin_m = 100.0
points_per_side = 2

[task]
threshold_db = 5.0

[learner]
episodes = 60
replay_start = 200
replay_capacity = 20000

[evaluation]
n_sampled = 100
"""
"""4 x 4 cells, 60 flights; some cells lie below the threshold and some above, so nothing is warned of."""

BRIEF = {
    "rounds": 5,
    "flights": 8,
    "steps_per_round": 8,
    "updates_per_round": 2,
    "batch_size": 64,
    "goals_per_round": 8,
    "sweeps": 2,
    "hidden_units": 8,
}
"""Settings of a training of FQI-HER that is short rather than good."""
BRIEF_FLAGS = tuple(word for name, value in BRIEF.items() for word in (f"--learner.{name.replace('_', '-')}", str(value)))


@dataclass(frozen=True)
class Result:
    """Exit code and both streams of one call."""

    code: int
    out: str
    err: str


Cli = Callable[..., Result]


def strict_json(text: str) -> Any:
    """JSON as the standard has it: NaN and Infinity are refused."""

    def refuse(constant: str) -> NoReturn:
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


def tree(folder: Path) -> dict[str, bytes | None]:
    """Every file below a folder with its bytes, every folder with None."""
    return {str(path.relative_to(folder)): path.read_bytes() if path.is_file() else None for path in sorted(folder.rglob("*"))}


def assert_refused(result: Result, *named: str) -> None:
    """Exit code 2, nothing on standard output, one line on standard error that names the thing."""
    assert result.code == 2, result
    assert result.out == ""
    lines = result.err.splitlines()
    assert lines, "nothing on standard error"
    assert lines[-1].startswith("cellpilot: "), result.err
    assert "Traceback" not in result.err
    for name in named:
        assert name in lines[-1], lines[-1]
    assert len(lines) == 1, f"more than one line on standard error: {lines}"
