"""TensorBoard scalars: the learning curve of `train.nc` in means of chunks, the evaluation, runs cut and gone on with."""

import json
import struct
from collections import defaultdict
from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cli_tools import Cli, assert_refused, tree

from cellpilot import scalars
from cellpilot.scalars import ScalarLog, ask_for_log

Curves = dict[str, dict[int, float]]


def read_scalars(folder: Path) -> Curves:
    """Values by tag and step over all event files of a folder; a purge takes away what is later, as in TensorBoard."""
    from tensorboardX.proto.event_pb2 import Event, SessionLog

    curves: Curves = defaultdict(dict)
    for file in sorted(folder.glob("events.*"), key=lambda path: path.suffix):
        content, at = file.read_bytes(), 0
        while at < len(content):
            (length,) = struct.unpack_from("<Q", content, at)
            event = Event.FromString(content[at + 12 : at + 12 + length])
            at += 12 + length + 4
            if event.session_log.status == SessionLog.START:
                for curve in curves.values():
                    for step in [step for step in curve if step >= event.step]:
                        del curve[step]
            for value in event.summary.value:
                assert event.step not in curves[value.tag], f"{value.tag} twice at {event.step}"
                curves[value.tag][event.step] = value.simple_value
    return curves


@pytest.fixture
def history() -> dict[str, np.ndarray]:
    """A learning curve of seven rounds."""
    rng = np.random.default_rng(0)
    return {column: rng.random(7) for column in scalars.TAGS}


def test_the_learning_curve_stands_in_means(tmp_path: Path, history: dict[str, np.ndarray]) -> None:
    ask_for_log(tmp_path)
    log = ScalarLog(tmp_path)
    for n in (3, 3, 5, 7):
        log.add_history({column: values[:n] for column, values in history.items()}, 3)
    log.close()
    curves = read_scalars(tmp_path / "tensorboard")
    assert set(curves) == set(scalars.TAGS.values())
    for column, tag in scalars.TAGS.items():
        values = history[column]
        assert curves[tag] == pytest.approx({3: values[:3].mean(), 5: values[3:5].mean(), 7: values[5:].mean()})


def test_a_log_asked_for_late_begins_at_the_start(tmp_path: Path, history: dict[str, np.ndarray]) -> None:
    ask_for_log(tmp_path)
    log = ScalarLog(tmp_path)
    log.add_history(history, 3)
    log.close()
    assert read_scalars(tmp_path / "tensorboard")["train/reached"].keys() == {3, 6, 7}


def test_rounds_beyond_the_checkpoint_are_trained_again_and_stand_once(tmp_path: Path, history: dict[str, np.ndarray]) -> None:
    ask_for_log(tmp_path)
    killed = ScalarLog(tmp_path)
    for n in (2, 4, 6):
        killed.add_history({column: values[:n] + 5 for column, values in history.items()}, 2)
    killed.close()
    resumed = ScalarLog(tmp_path)
    for n in (2, 4, 6):
        resumed.add_history({column: values[:n] for column, values in history.items()}, 2)
    resumed.close()
    curve = read_scalars(tmp_path / "tensorboard")["train/return"]
    values = history["episode_return"]
    assert curve == pytest.approx({2: values[:2].mean(), 4: values[2:4].mean(), 6: values[4:6].mean()})
    assert len(list((tmp_path / "tensorboard").iterdir())) == 1


def test_a_resumed_curve_has_no_hole_where_the_last_points_never_reached_the_disk(
    tmp_path: Path, history: dict[str, np.ndarray]
) -> None:
    ask_for_log(tmp_path)
    killed = ScalarLog(tmp_path)
    killed.add_history({column: values[:2] for column, values in history.items()}, 2)
    killed.close()
    resumed = ScalarLog(tmp_path)  # its checkpoint is four rounds further than the file
    resumed.add_history({column: values[:6] for column, values in history.items()}, 2)
    resumed.add_evaluation({"greedy": {"score": 0.0}}, 6)
    resumed.close()
    assert read_scalars(tmp_path / "tensorboard")["train/return"].keys() == {2, 4, 6}
    again = ScalarLog(tmp_path)
    again.add_history(history, 7)
    again.close()
    curves = read_scalars(tmp_path / "tensorboard")
    assert curves["train/return"].keys() == {7}
    assert curves["evaluation/score/greedy"] == {6: 0.0}, "the evaluation went with the curve"


def test_rounds_in_which_no_flight_ended_are_no_zeros(tmp_path: Path) -> None:
    gap = np.array([np.nan, np.nan, 4.0, np.nan, 10.0, 1.0])
    history = dict.fromkeys(("episode_return", "n_steps", "reached"), gap)
    history |= {"exploration": np.ones(6), "flights": np.array([0, 0, 1, 0, 3, 1.0])}
    ask_for_log(tmp_path)
    log = ScalarLog(tmp_path)
    log.add_history(history, 2)
    log.close()
    curves = read_scalars(tmp_path / "tensorboard")
    assert curves["train/return"] == pytest.approx({4: 4.0, 6: 31 / 4})
    assert curves["train/exploration"].keys() == {2, 4, 6}


def test_run_writes_curve_and_evaluation(place: Path, cli: Cli) -> None:
    result = cli("run", "tiny.toml", "--out", "new", "--tensorboard", "--evaluation.n-sampled", "20")
    assert result.code == 0, result.err
    curves = read_scalars(place / "new" / "tensorboard")
    with xr.open_dataset(place / "new" / "train.nc", engine="h5netcdf") as dataset:
        for column, tag in scalars.TAGS.items():
            assert curves[tag] == pytest.approx({60: float(dataset[column].mean())}, rel=1e-5)
    evaluation = json.loads(cli("evaluate", "new", "--json").out)["policies"]
    for policy in ("greedy", "optimal", "learned/argmax"):
        assert curves[f"evaluation/reached_share/{policy}"] == pytest.approx({60: evaluation[policy]["reached_share"]})
    assert cli("run", "tiny.toml", "--out", "new", "--force", "--learner.episodes", "3").code == 0
    assert not (place / "new" / "tensorboard").exists()


def test_seeds_are_logged_apart_and_a_resumed_run_goes_on(place: Path, cli: Cli) -> None:
    few = ("--learner.episodes", "12", "--learner.replay-start", "100", "--learner.updates-per-episode", "2")
    assert cli("train", "tiny.toml", "--out", "many", "--seeds", "2", "--tensorboard", *few).code == 0
    first, second = (read_scalars(place / f"many-seed{seed}" / "tensorboard") for seed in (0, 1))
    assert first.keys() == second.keys() == set(scalars.TAGS.values())
    assert first["train/return"] != second["train/return"]
    assert cli("train", "--resume", "many-seed0", "--tensorboard").code == 0
    assert read_scalars(place / "many-seed0" / "tensorboard") == first


@pytest.mark.parametrize("asked", ["by flag", "by folder"])
def test_without_the_extra_it_is_named(place: Path, cli: Cli, monkeypatch: pytest.MonkeyPatch, asked: str) -> None:
    monkeypatch.setattr(scalars, "find_spec", lambda name: None)
    if asked == "by folder":
        (place / "run" / "tensorboard").mkdir()
    before = tree(place)
    call = ["train", "tiny.toml", "--out", "new", "--tensorboard"] if asked == "by flag" else ["train", "--resume", "run"]
    assert_refused(cli(*call), "pip install 'cellpilot[tb]'")
    assert tree(place) == before
