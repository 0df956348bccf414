"""`write_report`: the self-contained page of a run, and its figures as files."""

import json
from pathlib import Path
from typing import Any

from cellpilot.evaluate.metrics import METRICS, number_metrics
from cellpilot.report import html, tables
from cellpilot.report.figures import draw_figures
from cellpilot.report.numbers import count
from cellpilot.report.thesis import PUBLISHED_IN
from cellpilot.report.words import summary_paragraphs
from cellpilot.runs import RunFacts
from cellpilot.runs.content import Content, load_content
from cellpilot.storage import write_atomically


def write_report(run: Path) -> Path:
    """Read a run folder, write `report.html` and `figures/<stem>.png` and `.pdf` into it, and return the path of the page.

    The page needs nothing but itself. Figures whose data the folder lacks are left out. `InputError` where the folder
    has no readable `map.nc` or `eval.nc`; nothing half-written stays.
    """
    content = load_content(run)
    pictures = draw_figures(content, run / "figures")
    document = html.page(
        content.scenario,
        [
            *(html.paragraph(text) for text in summary_paragraphs(content)),
            html.section("Results", *_result_tables(content)),
            html.section("Figures", html.figures(pictures)),
            html.section("Where this comes from", html.definitions(provenance(content))),
        ],
    )
    path = run / "report.html"
    write_atomically(path, document)
    return path


def _result_tables(run: Content) -> list[str]:
    metrics, columns = run.metrics, number_metrics()
    headings = [column.heading for column in columns.values()]
    n_flights = count(run.flights.sizes["flight"])
    parts = [html.table("Summary", headings, tables.main_rows(metrics, columns)), html.paragraph(_basis(run, n_flights))]
    if metrics["exhaustive"]:
        rows = tables.policy_rows(metrics["sampled"], "sampled", columns)
        parts.append(html.table(f"{n_flights} sampled flights, with 95 % intervals in brackets", headings, rows))
    class_headings, class_rows = tables.rf_class_rows(metrics)
    parts.append(html.table(METRICS["rf_class_share"].long_name.removesuffix("."), class_headings, class_rows))
    parts.append("<h3>What the columns mean</h3>")
    parts.append(html.column_words(columns))
    return parts


def _basis(run: Content, n_flights: str) -> str:
    pairs = count(run.metrics["n_pairs"])
    if run.metrics["exhaustive"]:
        text = (
            f"Rows marked exact cover all {pairs} start-goal pairs, in expectation over noise and over the choices of a policy "
            "that draws its actions; outages and handovers come from drawn flights."
        )
    else:
        text = f"No row is exact: {n_flights} flights were drawn from {pairs} start-goal pairs; 95 % intervals stand in brackets."
    if run.scenario in PUBLISHED_IN:
        text += f" Rows marked published are the thesis's {PUBLISHED_IN[run.scenario]}, measured on its own map."
    return text


def provenance(run: Content) -> dict[str, str]:
    """Where the numbers come from: map, task, training, seed, versions and command, as far as the folder tells."""
    about, attrs = run.facts, run.radio_map.attrs
    training = run.training.attrs if run.training is not None else {}
    facts: dict[str, Any] = {
        "map": ", ".join(str(attrs[name]) for name in ("source", "model") if attrs.get(name)),
        "licence of the map": attrs.get("licence"),
        "seed of the map": attrs.get("seed"),
        "task": ", ".join(f"{name} = {value:g}" for name, value in run.task.as_dict().items()),
        "noise_std_db": f"{run.world.signal.noise_std_db:g}",
        "seed": training.get("seed") if about is None else about.seed,
        "learner": training.get("algorithm"),
        "exploration": training.get("exploration"),
        **({} if about is None else _of_training(about)),
        "digests of what was evaluated": _versions(run.flights.attrs.get("made_from")),
        "versions that made the map": _versions(attrs.get("provenance")),
    }
    return {name: str(fact) for name, fact in facts.items() if fact not in (None, "")}


def _of_training(about: RunFacts) -> dict[str, Any]:
    return {
        "training time, without compilation": _seconds(about.train_wall_s),
        "compilation": _seconds(about.compile_s),
        "updates": None if about.updates is None else count(about.updates),
        "environment steps": None if about.env_steps is None else count(about.env_steps),
        "cores": about.cores,
        "command": about.command,
        "versions": _versions(about.versions),
    }


def _seconds(value: float | None) -> str | None:
    return None if value is None else f"{value:.1f} s"


def _versions(value: Any) -> str | None:
    """Versions as text; the map keeps them as JSON."""
    if isinstance(value, str):
        try:
            value = json.loads(value)
        except ValueError:
            return value
    if not isinstance(value, dict):
        return None
    return ", ".join(f"{name} {version}" for name, version in value.items())
