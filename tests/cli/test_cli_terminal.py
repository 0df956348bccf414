"""A terminal that closes, a reader that goes, a disk without a single free block: the work is kept."""

import os
import pty
import select
import subprocess
import sys
import time
from pathlib import Path

import pytest

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps.attributes import plain_attributes
from cellpilot.runs import create_run, evaluate_run, save_evaluation, stale_parts
from cellpilot.scenario import EvaluationSettings, Scenario, SimulatedMap
from cellpilot.storage import hold

COMMAND = (sys.executable, "-c", "import sys; from cellpilot.cli.main import main; sys.exit(main())")


def test_a_training_whose_terminal_closes_is_saved(tmp_path: Path) -> None:
    master, slave = pty.openpty()
    # The first terminal that a new session opens is its own.
    program = "import os; os.open(os.ttyname(0), os.O_RDWR); " + COMMAND[-1]
    words = ["train", "quick", "--out", "r", "--learner.rounds", "100000"]
    environment = os.environ | {"TERM": "xterm", "COLUMNS": "200"}
    training = subprocess.Popen(
        [*COMMAND[:-1], program, *words],
        cwd=tmp_path,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        start_new_session=True,
        env=environment,
    )
    os.close(slave)
    shown, until = b"", time.monotonic() + 120
    while b"return" not in shown and time.monotonic() < until:
        if select.select([master], [], [], 1.0)[0]:
            shown += os.read(master, 1000)
    assert b"return" in shown
    os.close(master)
    assert training.wait(60) == 130
    assert (tmp_path / "r" / "state.safetensors").is_file()


def test_a_reader_that_goes_does_not_change_the_exit_code(tmp_path: Path) -> None:
    reader, writer = os.pipe()
    os.close(reader)
    words = ["plan", "thesis-2d", "--start", "1,1,0", "--goal", "17,15,0"]
    ended = subprocess.run([*COMMAND, *words], cwd=tmp_path, stdout=writer, stderr=subprocess.PIPE, check=False)
    os.close(writer)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_folder_can_be_held_on_a_full_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def no_room(descriptor: int, data: bytes) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", no_room)
    with hold(tmp_path), pytest.raises(InputError, match="in use"), hold(tmp_path):
        pass


def test_an_evaluation_names_the_policy_that_was_evaluated(tmp_path: Path) -> None:
    scenario = Scenario(
        map=SimulatedMap(x_range_m=(-60.0, 60.0), y_range_m=(-60.0, 60.0), bin_m=30.0, points_per_side=1),
        learner=FQIHER(rounds=1),
        evaluation=EvaluationSettings(n_sampled=10),
    )
    run = create_run(tmp_path / "r", scenario, 0, "test")
    evaluation = evaluate_run(run)
    assert evaluation.made_from["policy"] == "none"
    source = next(Path(__file__).parents[2].glob("src/cellpilot/scenarios/thesis-2d.safetensors"))
    run.policy_file.write_bytes(source.read_bytes())  # a training ends while the evaluation goes on
    save_evaluation(run, evaluation)
    assert stale_parts(run) == ["policy"]


@pytest.mark.parametrize("seed", [10**30, -(2**63) - 1])
def test_a_number_of_more_than_64_bits_is_refused(seed: int) -> None:
    with pytest.raises(InputError, match=r"seed .* 64 bits"):
        plain_attributes({"seed": seed}, "m.csv")
