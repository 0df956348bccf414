"""A new metric is one entry of a table: JSON, terminal, page and file checks follow, and the documentation lists all."""

import json
from pathlib import Path

import pytest
from rich.console import Console

from cellpilot.cli.main import main
from cellpilot.evaluate.metrics import METRICS, Metric, all_metrics
from cellpilot.evaluate.summary import Summary

TINY = """\
name = "tiny"

[map]
heights_m = [30.0]
bin_m = 100.0
points_per_side = 2

[task]
threshold_db = 5.0

[evaluation]
n_sampled = 20
"""


def steps_per_flight(summary: Summary) -> float:
    return summary.n_steps / summary.n_flights


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> None:
    metric = Metric(
        steps_per_flight, "mean length", "steps", "Steps of a flight, mean over all <flights>.", "number", "routes", "len"
    )
    monkeypatch.setitem(METRICS, "steps_per_flight", metric)


def test_one_entry_adds_a_metric_to_json_terminal_and_page(
    added: None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from cellpilot.report import text_table
    from cellpilot.runs import create_run
    from cellpilot.scenario import load_scenario

    monkeypatch.chdir(tmp_path)
    (tmp_path / "tiny.toml").write_text(TINY)
    create_run(tmp_path / "run", load_scenario(tmp_path / "tiny.toml"), 0, "test")
    assert main(["evaluate", "run", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    greedy = found["policies"]["greedy"]
    # All ordered pairs of a 4 x 4 grid lie 8/3 steps apart on average.
    assert greedy["steps_per_flight"] == pytest.approx(8 / 3)
    console = Console(width=120)
    with console.capture() as capture:
        console.print(text_table(found))
    heading, _, first, *_ = [line for line in capture.get().splitlines() if "len" in line or "─" in line or "greedy" in line]
    assert heading.split()[heading.split().index("len") - 1] == "return"
    assert "2.67" in first.split()
    assert main(["report", "run"]) == 0
    page = (tmp_path / "run" / "report.html").read_text()
    assert '<th scope="col">mean length [steps]</th>' in page
    assert "<td>2.67</td>" in page
    assert "<dt>mean length [steps]</dt><dd>Steps of a flight, mean over all &lt;flights&gt;.</dd>" in page


def test_the_documentation_lists_every_metric_with_its_label_and_unit() -> None:
    text = (Path(__file__).parents[2] / "docs" / "files.md").read_text()
    for name, metric in all_metrics().items():
        assert f"| `{name}` | {metric.label} | {metric.unit} | {metric.long_name} |" in text
        if metric.interval is not None:
            assert f"`{metric.interval.name}`" in text
