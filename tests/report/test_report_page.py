"""Whole reports of synthetic run folders: what the page holds, which figures are there, and that they are labelled."""

import io
import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest
import xarray as xr
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.text import Text
from report_runs import made_up_training, random_parameters, small_map, write_run
from rich.console import Console

from cellpilot.errors import InputError
from cellpilot.evaluate import METRICS, Evaluation
from cellpilot.report import text_table, write_report
from cellpilot.report.figures import FIGURES
from cellpilot.report.learning import draw_training
from cellpilot.report.numbers import percent
from cellpilot.report.style import drawing_settings
from cellpilot.report.thesis import PUBLISHED
from cellpilot.report.words import summary_paragraphs
from cellpilot.runs.content import load_content
from cellpilot.world import World

Reported = tuple[Path, Evaluation]


@pytest.fixture(scope="session")
def full(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """A 2D run with everything a folder can hold; scenario of the thesis."""
    folder = tmp_path_factory.mktemp("runs") / "full"
    radio_map = small_map(special=True)
    parameters = random_parameters(World.from_map(radio_map))
    result = write_run(folder, radio_map, scenario="thesis-2d", parameters=parameters, episodes=300, studies=True)
    write_report(folder)
    return folder, result


@pytest.fixture(scope="session")
def bare(tmp_path_factory: pytest.TempPathFactory) -> Reported:
    """A noisy 3D run with nothing but map and sampled evaluation, on a map without sectors."""
    folder = tmp_path_factory.mktemp("runs") / "bare"
    result = write_run(folder, small_map(2, sectors=False), scenario="a <b> & c", noise_std_db=2.0, max_exhaustive_pairs=0)
    write_report(folder)
    return folder, result


class Tags(HTMLParser):
    """Collects the tags of a page and checks that they nest."""

    def __init__(self) -> None:
        super().__init__()
        self.found: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.found.append((tag, dict(attrs)))
        if tag not in ("meta", "img", "link", "br"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


def tags_of(folder: Path) -> Tags:
    tags = Tags()
    tags.feed((folder / "report.html").read_text(encoding="utf-8"))
    return tags


def page_text(folder: Path) -> str:
    page = re.sub(r'src="[^"]*"', "", (folder / "report.html").read_text(encoding="utf-8"))
    return page.replace("&nbsp;", " ")


@pytest.mark.parametrize("which", ["full", "bare"])
def test_the_page_needs_nothing_but_itself(which: str, request: pytest.FixtureRequest) -> None:
    folder, _ = request.getfixturevalue(which)
    tags = tags_of(folder)
    assert tags.open == []
    for tag, attrs in tags.found:
        assert tag not in ("script", "link", "iframe", "object", "embed", "base")
        assert "href" not in attrs
        assert (attrs.get("src") or "data:").startswith("data:")
    text = page_text(folder)
    assert not re.search(r"url\(|@import|https?:|file:", text)
    assert str(folder) not in text


@pytest.mark.parametrize("which", ["full", "bare"])
def test_every_picture_has_words_for_those_who_cannot_see_it(which: str, request: pytest.FixtureRequest) -> None:
    folder, _ = request.getfixturevalue(which)
    images = [attrs for tag, attrs in tags_of(folder).found if tag == "img"]
    assert len(images) == len(list((folder / "figures").glob("*.png")))
    assert all(len(attrs["alt"] or "") > 20 for attrs in images)


def stems(folder: Path) -> set[str]:
    found = {path.stem for path in (folder / "figures").glob("*.png")}
    assert found == {path.stem for path in (folder / "figures").glob("*.pdf")}
    assert len(list((folder / "figures").iterdir())) == 2 * len(found)
    return found


def test_a_full_2d_run_has_all_figures_but_the_height(full: Reported) -> None:
    assert stems(full[0]) == set(FIGURES) - {"altitude"}


def test_figures_without_data_are_left_out(bare: Reported) -> None:
    assert stems(bare[0]) == set(FIGURES) - {"deployment", "training", "ablation", "sensitivity"}


def test_the_page_holds_the_numbers(full: Reported) -> None:
    folder, result = full
    text = page_text(folder)
    for row in (*result.policies.values(), *PUBLISHED["thesis-2d"].values()):
        assert percent(row["low_sinr_share"]) in text
        assert percent(row["reached_share"]) in text
    for row in result.sampled.values():
        low, high = (percent(bound).removesuffix(" %") for bound in row["low_sinr_ci95"])
        assert f"({low} to {high})" in text
    assert "Table 5.1" in text
    assert "Rows marked exact cover all" in text
    assert "synthetic &lt;test&gt;" in text
    assert "cellpilot run &lt;scenario&gt;" in text
    assert all(metric.label in text for metric in METRICS.values() if metric.form != "list")


def test_failure_of_the_learned_policy_is_named(full: Reported) -> None:
    folder, result = full
    failed = 1 - result.policies["learned/argmax"]["reached_share"]
    assert failed > 0
    assert f"fails to reach the goal in {percent(failed)} of the flights" in page_text(folder)


def test_a_sampled_run_says_that_nothing_is_exact(bare: Reported) -> None:
    text = page_text(bare[0])
    assert "No row is exact" in text
    assert "published" not in text.split("</style>")[1]
    assert "<h1>a &lt;b&gt; &amp; c</h1>" in text
    assert "The run has no learned policy" in text


def drawn(folder: Path) -> dict[str, Figure]:
    run = load_content(folder)
    figures = {}
    with drawing_settings():
        for stem, entry in FIGURES.items():
            figure = entry.draw(run)
            if figure is not None:
                figure.savefig(io.BytesIO(), format="png", dpi=30)
                figures[stem] = figure
    return figures


def is_colour_bar(axes: Axes) -> bool:
    return axes.get_label() == "<colorbar>"


def check_labels(stem: str, axes: Axes) -> None:
    """A colour bar has one label; another axis has its own unless a neighbour's ticks and label serve it."""
    if is_colour_bar(axes):
        assert axes.get_xlabel() or axes.get_ylabel(), f"{stem}: a colour bar has no label"
        return
    for axis in (axes.xaxis, axes.yaxis):
        ticked = any(tick.label1.get_visible() and tick.label1.get_text() for tick in axis.get_major_ticks())
        assert axis.get_label_text() or not ticked, f"{stem}: axis {axis.axis_name} has no label"


@pytest.mark.parametrize("which", ["full", "bare"])
def test_every_axis_has_a_name_and_a_unit_and_no_text_is_tiny(which: str, request: pytest.FixtureRequest) -> None:
    for stem, figure in drawn(request.getfixturevalue(which)[0]).items():
        for axes in figure.axes:
            check_labels(stem, axes)
            for label in (axes.get_xlabel(), axes.get_ylabel()):
                assert not label or re.search(r"\[[^\]]+\]", label), f"{stem}: {label!r} has no unit"
        labels = {axes.get_xlabel() for axes in figure.axes} | {axes.get_ylabel() for axes in figure.axes}
        assert len(labels - {""}) >= 2, stem
        tiny = [text.get_text() for text in figure.findobj(Text) if text.get_text() and text.get_fontsize() < 8]
        assert not tiny, f"{stem}: {tiny}"


def test_the_label_check_finds_a_picture_without_labels() -> None:
    axes = Figure().add_subplot()
    axes.plot([1, 2], [3, 4])
    axes.set_xlabel("x [m]")
    axes.get_figure().draw_without_rendering()
    with pytest.raises(AssertionError, match="axis y has no label"):
        check_labels("bad", axes)


def test_policy_figures_say_whose_actions_they_show(full: Reported, bare: Reported) -> None:
    for (folder, _), words in ((full, "learned, arg max"), (bare, "nothing is learned")):
        titles = [axes.get_title() for axes in FIGURES["policy_low_goal"].draw(load_content(folder)).axes]  # type: ignore[union-attr]
        assert any(words in title for title in titles)


@pytest.mark.parametrize("counts", ["episodes", "rounds"])
def test_the_learning_curve_counts_what_the_learner_counts(full: Reported, counts: str) -> None:
    figure = draw_training(replace(load_content(full[0]), training=made_up_training(100, counts=counts)))
    assert figure is not None
    texts = [figure.axes[-1].get_xlabel(), *(text.get_text() for text in figure.axes[0].get_legend().get_texts())]
    assert texts == [f"training {counts} [1]", "10th to 90th percentile", f"mean of 10 {counts}"]


def test_sums_that_are_one_but_for_rounding_are_no_failure(full: Reported) -> None:
    run = load_content(full[0])
    run.metrics["policies"]["learned/argmax"]["reached_share"] = 1 - 1e-13
    (text,) = (text for text in summary_paragraphs(run) if "arg max" in text)
    assert "It reaches the goal in every flight" in text
    assert "fails" not in text


def payload(result: Evaluation, scenario: str) -> dict[str, Any]:
    names = ("exhaustive", "n_pairs", "unreachable_pairs", "policies", "sampled")
    return {"scenario": scenario, **json.loads(json.dumps({name: getattr(result, name) for name in names}))}


def printed(metrics: dict[str, Any]) -> str:
    console = Console(width=160, file=io.StringIO(), record=True)
    console.print(text_table(metrics))
    return console.export_text()


def test_the_terminal_table_has_the_published_row_only_for_its_scenario(full: Reported) -> None:
    _, result = full
    text = printed(payload(result, "thesis-2d"))
    assert "exact, all" in text
    assert "greedy baseline" in text
    assert re.search(r"thesis: DDQN-HER.*99\.82 %.*3\.40 %.*2\.00", text)
    assert "thesis:" not in printed(payload(result, "my-town"))


def test_a_report_written_again_drops_pictures_it_no_longer_has(tmp_path: Path) -> None:
    write_run(tmp_path, small_map(sectors=False), n_sampled=20)
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "ablation.png").write_bytes(b"old")
    (tmp_path / "figures" / "mine.png").write_bytes(b"kept")
    assert write_report(tmp_path) == tmp_path / "report.html"
    assert not (tmp_path / "figures" / "ablation.png").exists()
    assert (tmp_path / "figures" / "mine.png").exists()


def test_a_folder_without_evaluation_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such folder"):
        write_report(tmp_path / "nothing")
    with pytest.raises(InputError, match=r"eval\.nc"):
        write_report(tmp_path)
    xr.Dataset(attrs={"metrics": "{"}).to_netcdf(tmp_path / "eval.nc", engine="h5netcdf")
    with pytest.raises(InputError, match="attribute missing or unreadable"):
        write_report(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["eval.nc"]
