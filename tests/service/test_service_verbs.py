"""The verbs as functions: what they return, what they tell, and that they are all that the commands do."""

import json
import re
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from cellpilot import InputError, plugins, service
from cellpilot.cli.main import main
from cellpilot.evaluate import METRICS
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.maps import load_map, make_map
from cellpilot.scenario import RewardSettings, Scenario, find_scenario, load_scenario


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    quick = load_scenario(find_scenario("quick"))
    return quick.model_copy(update={"name": "small", "learner": MapLearning(flights=10)})


@pytest.fixture(scope="module")
def trained(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> service.Trained:
    told: list[int] = []
    out = tmp_path_factory.mktemp("service") / "run"
    found = service.train(scenario, out, seeds=(3, 4), progress=lambda progress: told.append(progress.done))
    assert told[-1] == 10
    return found


def test_training_makes_a_run_for_each_seed(trained: service.Trained) -> None:
    assert trained.finished
    assert [run.folder.name for run in trained.runs] == ["run-seed3", "run-seed4"]
    first, second = (service.load_run(run.folder).parameters() for run in trained.runs)
    assert first is not None
    assert second is not None
    assert any(not np.array_equal(first.tensors[name], second.tensors[name]) for name in first.tensors)


def test_evaluation_is_saved_when_asked_and_equals_that_of_the_command(
    trained: service.Trained, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = trained.runs[0].folder
    shares: list[float] = []
    found = service.evaluate(folder, progress=shares.append, warn=pytest.fail)
    assert not (folder / "eval.nc").exists()
    assert shares[-1] == pytest.approx(1.0)
    assert set(found.payload["policies"]["greedy"]) >= {"score", "reached_share"} & METRICS.keys()
    assert main(["evaluate", str(folder), "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(found.payload))
    assert found.save() == folder / "eval.nc"


def test_report_is_one_page(trained: service.Trained) -> None:
    page = service.report(trained.runs[1].folder)
    assert page.name == "report.html"
    assert "<html" in page.read_text(encoding="utf-8")


def test_a_route_over_a_run_a_map_and_a_scenario(trained: service.Trained) -> None:
    run = trained.runs[0].folder
    over = [service.plan(source, (0, 0, 0), (9, 9, 0), warn=lambda line: None) for source in (run, "quick")]
    assert over[0].route.status == "reached"
    assert over[0].route.cells.tolist() == over[1].route.cells.tolist()
    assert service.plan(run, "0,0,0", "9,9,0", "learned").route.status == "reached"
    lower = service.plan(run, (0, 0, 0), (9, 9, 0), task=RewardSettings(threshold_db=-90.0), warn=lambda line: None)
    assert lower.route.n_steps == lower.route.shortest_steps == 18
    assert lower.payload["steps"][0]["position"] == [0, 0, 0]


def test_warnings_are_told_or_are_python_warnings(trained: service.Trained) -> None:
    run, told = trained.runs[0].folder, []
    service.plan(run, (0, 0, 0), (9, 9, 0), task=RewardSettings(threshold_db=-90.0), warn=told.append)
    assert len(told) == 1
    assert "hardly anything to avoid" in told[0]
    with pytest.warns(UserWarning, match="hardly anything to avoid"):
        service.plan(run, (0, 0, 0), (9, 9, 0), task=RewardSettings(threshold_db=-90.0))


def test_errors_name_arguments_here_and_options_on_the_command_line(
    scenario: Scenario, trained: service.Trained, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = trained.runs[0].folder
    with pytest.raises(InputError, match=r"^`start` is 'here'; expected three cells"):
        service.plan(run, "here", "9,9,0")
    assert main(["plan", str(run), "--start", "here", "--goal", "9,9,0"]) == 2
    assert capsys.readouterr().err.startswith("cellpilot: --start is 'here'; expected three cells")
    with pytest.raises(InputError, match=r"^`seeds` are 1, 1; expected different ones$"):
        service.train(scenario, tmp_path / "twice", seeds=(1, 1))
    with pytest.raises(InputError, match=r"is not empty; .*replace it with `force`"):
        service.train(scenario, run)
    assert not (tmp_path / "twice").exists()
    with pytest.raises(InputError, match=r"^`arms` none: no such arm"):
        service.adapt("quick", "quick", service.AdaptSettings(arms=("none",)))
    with pytest.raises(InputError, match=r"expected optimal, greedy or learned"):
        service.plan(run, (0, 0, 0), (9, 9, 0), "best")  # type: ignore[arg-type]


BRIEF = service.AdaptSettings(flights=2, seeds=1, arms=("map-prior",))


def test_adapt_leaves_its_folder(tmp_path: Path) -> None:
    found = service.adapt("quick", "quick", BRIEF, out=tmp_path / "study", warn=lambda line: None)
    assert found.data["score"].dims == ("arm", "seed", "flights")
    assert {path.name for path in found.folder.iterdir()} >= {"adapt.nc", "map-a.nc", "map-b.nc"}
    assert found.draw().is_file()


class Packages:
    """What an installed package would offer."""

    @staticmethod
    def read(path: Path) -> object:
        return make_map(
            np.full((1, 2, 3), float(path.read_text())), x_m=[0.0, 10.0, 20.0], y_m=[0.0, 10.0], z_m=[30.0], source="level"
        )

    @staticmethod
    def write_sides(parameters: object, path: Path) -> None:
        path.write_text(str(parameters.sides))  # type: ignore[attr-defined]


@pytest.fixture
def package(monkeypatch: pytest.MonkeyPatch) -> None:
    points = [
        EntryPoint("level", f"{__name__}:Packages", "cellpilot.map_sources"),
        EntryPoint("sides", f"{__name__}:Packages.write_sides", "cellpilot.exports"),
    ]
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point for point in points if point.group == group])
    plugins.offered.cache_clear()
    yield
    plugins.offered.cache_clear()


@pytest.mark.usefixtures("package")
def test_packages_offer_map_sources_and_exports(
    trained: service.Trained, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "flat.level"
    file.write_text("7.5")
    assert (load_map(file)["sinr_db"] == 7.5).all()
    assert main(["map", "info", str(file)]) == 0
    assert main(["map", "convert", str(tmp_path / "flat.level"), str(tmp_path / "other.level")]) == 2
    assert "not written to it" in capsys.readouterr().err
    service.export_policy(trained.runs[0].folder, tmp_path / "policy.sides")
    assert (tmp_path / "policy.sides").read_text() == "(10, 10, 1)"
    assert main(["doctor"]) == 0
    shown = capsys.readouterr().out
    assert "map sources of other packages: level" in shown
    assert "exports of other packages: sides" in shown


def test_the_way_to_write_is_asked_of_the_ending(trained: service.Trained, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"expected a name that ends in \.onnx$"):
        service.export_policy(trained.runs[0].folder, tmp_path / "policy.txt")


def test_an_evaluation_of_another_map_is_not_saved_into_the_run(trained: service.Trained) -> None:
    run = trained.runs[0]
    elsewhere = service.evaluate(run, run.radio_map.assign(sinr_db=run.radio_map["sinr_db"] + 5), warn=lambda line: None)
    before = (run.folder / "eval.nc").read_bytes() if (run.folder / "eval.nc").exists() else None
    with pytest.raises(InputError, match="another map"):
        elsewhere.save()
    assert before == ((run.folder / "eval.nc").read_bytes() if (run.folder / "eval.nc").exists() else None)


def test_a_package_that_fails_at_its_import_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Failing(EntryPoint):
        def load(self) -> object:
            raise ValueError("no licence")

    monkeypatch.setattr(plugins, "entry_points", lambda group: [Failing("bad", "bad:x", group)])
    with pytest.raises(InputError, match=r"the export bad \(bad:x\) cannot be imported \(no licence\)"):
        plugins.offered.__wrapped__("cellpilot.exports")


@pytest.mark.parametrize(
    "wrong", [{"seeds": 0}, {"flights": 0}, {"arms": ()}, {"arms": "map-prior"}, {"bin_m": -1.0}, {"deep_rounds": 0}]
)
def test_settings_of_adapt_have_bounds(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError, match=f"^{next(iter(wrong))} is "):
        BRIEF.changed(**wrong)


@pytest.mark.parametrize("seeds", [3, (), (0.5,), (-1,), (True,)])
def test_seeds_are_whole_numbers(scenario: Scenario, tmp_path: Path, seeds: object) -> None:
    with pytest.raises(InputError, match=r"^`seeds` is .*; expected whole numbers"):
        service.train(scenario, tmp_path / "run", seeds=seeds)  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("start", [None, (0.5, 0, 0), ("0", "0", "0"), (99, 0, 0), (0, 0)])
def test_places_are_cells_of_the_grid_or_text(trained: service.Trained, start: object) -> None:
    with pytest.raises(InputError, match=r"^`start` .*expected"):
        service.plan(trained.runs[0], start, (9, 9, 0))  # type: ignore[arg-type]


def test_one_folder_is_resumed(trained: service.Trained) -> None:
    assert service.resume(trained.runs[0].folder).finished
    with pytest.raises(InputError, match="nowhere: no such run folder"):
        service.resume("nowhere")


def test_a_warning_points_at_whoever_called(trained: service.Trained) -> None:
    with pytest.warns(UserWarning, match="hardly anything to avoid") as told:
        service.plan(trained.runs[0], (0, 0, 0), (9, 9, 0), task=RewardSettings(threshold_db=-90.0))
    assert told[0].filename == __file__


def test_names_of_the_verbs_are_listed() -> None:
    assert {"plan", "train", "AdaptSettings"} <= set(dir(service))


@pytest.mark.parametrize(
    ("point", "wrong"),
    [
        (EntryPoint("nc", f"{__name__}:Packages", "cellpilot.map_sources"), "its name is taken"),
        (EntryPoint("XYZ", f"{__name__}:Packages", "cellpilot.map_sources"), "not in small letters"),
        (EntryPoint("level", f"{__name__}:BRIEF", "cellpilot.map_sources"), r"has no function read\(path\)"),
        (EntryPoint("onnx", f"{__name__}:Packages.write_sides", "cellpilot.exports"), "its name is taken"),
        (EntryPoint("txt", "no_such_module:x", "cellpilot.exports"), "cannot be imported"),
    ],
    ids=["taken ending", "capitals", "no read", "taken export", "not importable"],
)
def test_offers_that_cannot_be_used_fail_in_doctor_and_stop_nothing_else(
    monkeypatch: pytest.MonkeyPatch,
    trained: service.Trained,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    point: EntryPoint,
    wrong: str,
) -> None:
    monkeypatch.setattr(plugins, "entry_points", lambda group: [point] if group == point.group else [])
    plugins.offered.cache_clear()
    try:
        assert main(["doctor"]) == 1
        assert re.search(f"FAIL .*{wrong}", capsys.readouterr().out)
        service.export_policy(trained.runs[0].folder, tmp_path / "policy.onnx")
    finally:
        plugins.offered.cache_clear()
