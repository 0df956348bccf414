"""Break each part once, in a copy, and show that the suite over random triples fails for it.

    python tests/evaluate/break_each_once.py [WORD]     # only the parts whose name has the word

A copy of the package is edited in one place after another; the suite runs on each copy, and on an unedited one at last.
The exit code is 1 where a broken part went unnoticed.
"""

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).parents[2]
SUITE = "tests/evaluate/test_evaluate_triples.py"


class Edit(NamedTuple):
    """One wrong line."""

    part: str
    file: str
    right: str
    wrong: str


EDITS = (
    Edit(
        "expected outcome: another cell's chance", "task.py", "low_probability[next_cell], moves", "low_probability[cell], moves"
    ),
    Edit(
        "compiled environment: measures the cell it leaves",
        "envs/flight.py",
        "measure(next_cell, error_db, noise)",
        "measure(cell, error_db, noise)",
    ),
    Edit(
        "Gymnasium, one flight: measures the cell it leaves",
        "envs/goal_env.py",
        "measure(next_cell, error_db, noise)",
        "measure(cell, error_db, noise)",
    ),
    Edit(
        "Gymnasium, many flights: leaves out what is unknown of the map",
        "envs/vector_env.py",
        "measure(cells, error_db, noise)",
        "measure(cells, None, noise)",
    ),
    Edit(
        "sampled flights: measures the cell it leaves",
        "evaluate/flights.py",
        "measure(next_cell, error_db, noise)",
        "measure(cell, error_db, noise)",
    ),
    Edit(
        "exact, deterministic: a blocked cell counts as the goal",
        "evaluate/exact.py",
        "by_cell(at_goal.ravel()[end])",
        "by_cell(over[end])",
    ),
    Edit(
        "exact, stochastic: flies on from blocked cells",
        "evaluate/exact.py",
        "        flying[world.airspace.blocked] = 0.0\n",
        "",
    ),
    Edit(
        "value iteration: goes on after the end",
        "solve/values.py",
        "np.where(terminated[action], 0.0, future)",
        "future",
    ),
    Edit("policy iteration: ends after one improvement", "solve/values.py", "if not better.any():", "if True:"),
    Edit(
        "cheapest paths: the chance of the cell it leaves",
        "solve/cheapest_paths.py",
        "(task.threshold_db)[target]",
        "(task.threshold_db)[source]",
    ),
    Edit(
        "target of DDQN-HER: goes on after the end",
        "learn/losses.py",
        "jnp.where(terminated, 0.0, (q_next_target * best).sum(-1))",
        "(q_next_target * best).sum(-1)",
    ),
    Edit("n-step target: rewards are not discounted", "learn/n_step.py", "task.discount**ahead * reward", "reward"),
    Edit(
        "target of FQI-HER with a model: goes on after the end",
        "learn/algorithms/fqi_her_targets.py",
        "jnp.where(over, 0.0, task.discount * value[arena",
        "(task.discount * value[arena",
    ),
    Edit(
        "target of FQI-HER without a model: goes on after the end",
        "learn/algorithms/fqi_her_targets.py",
        "jnp.where(over, 0.0, task.discount * value)\n",
        "task.discount * value\n",
    ),
    Edit(
        "map learner: plans without its uncertainty",
        "learn/algorithms/map_learner.py",
        "self._world(self.posterior.mean_db, self.posterior.std_db)",
        "self._world(self.posterior.mean_db, 0 * self.posterior.std_db)",
    ),
)


def failures(package: Path) -> tuple[int, str]:
    """How many cases of the suite fail with a copy of the package, and the names of their tests."""
    command = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "-n", "auto", "--tb=no", SUITE]
    found = subprocess.run(
        command, cwd=ROOT, env=os.environ | {"PYTHONPATH": str(package)}, capture_output=True, text=True, check=False
    )
    names = [line.split()[1].split("::")[1].split("[")[0] for line in found.stdout.splitlines() if line.startswith("FAILED")]
    if found.returncode not in (0, 1):
        raise SystemExit(found.stdout + found.stderr)
    return len(names), ", ".join(sorted(set(names)))


def main() -> int:
    """Print a line for each edit."""
    unnoticed = 0
    with tempfile.TemporaryDirectory() as folder:
        word = sys.argv[1] if len(sys.argv) > 1 else ""
        for edit in (*(edit for edit in EDITS if word in edit.part), None):
            package = Path(folder) / "src"
            shutil.copytree(ROOT / "src", package, dirs_exist_ok=True)
            if edit is not None:
                file = package / "cellpilot" / edit.file
                text = file.read_text(encoding="utf-8")
                if edit.right not in text:
                    raise SystemExit(f"{edit.file}: {edit.right!r} is not there; mend this list")
                file.write_text(text.replace(edit.right, edit.wrong), encoding="utf-8")
            n_failed, names = failures(package)
            wrong = n_failed == 0 if edit is not None else n_failed > 0
            unnoticed += wrong
            sys.stdout.write(
                f"{'WRONG' if wrong else 'ok'}  {edit.part if edit else 'nothing broken'}: {n_failed} fail {names}\n"
            )
            sys.stdout.flush()
    return 1 if unnoticed else 0


if __name__ == "__main__":
    sys.exit(main())
