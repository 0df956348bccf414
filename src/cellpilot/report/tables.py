"""Tables of one evaluation: this run's rows beside the published ones, as data, for the terminal and for the page."""

from collections.abc import Mapping
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

from cellpilot.evaluate.metrics import RF_CLASSES_DB, Metric, number_metrics
from cellpilot.report.numbers import count, percent, show
from cellpilot.report.style import policy_line
from cellpilot.report.thesis import PUBLISHED


class Row(NamedTuple):
    """A row: the policy, how the numbers came about, and the text of each column by name."""

    policy: str
    source: str
    cells: dict[str, str]


Columns = Mapping[str, Metric[Any]]


def policy_rows(rows: dict[str, dict[str, Any]], source: str, columns: Columns) -> list[Row]:
    """One row per policy, with the 95 % interval behind each value that has one."""
    return [
        Row(
            policy_line(policy).label,
            source,
            {name: show(row.get(name), column.form) + _interval(row, column) for name, column in columns.items()},
        )
        for policy, row in rows.items()
    ]


def _interval(row: dict[str, Any], column: Metric[Any]) -> str:
    bounds = None if column.interval is None else row.get(column.interval.name)
    if bounds is None:
        return ""
    low, high = (show(bound, column.form).removesuffix(" %") for bound in bounds)
    return f" ({low} to {high})"


def published_rows(scenario: str, columns: Columns) -> list[Row]:
    """The thesis's rows for a scenario; none for another one."""
    return [
        Row(policy, "published", {name: show(row.get(name), column.form) for name, column in columns.items()})
        for policy, row in PUBLISHED.get(scenario, {}).items()
    ]


def main_rows(metrics: dict[str, Any], columns: Columns) -> list[Row]:
    """This run (exact if it is exhaustive, else sampled with intervals), then the published rows."""
    return policy_rows(metrics["policies"], source_of(metrics), columns) + published_rows(str(metrics.get("scenario")), columns)


def source_of(metrics: dict[str, Any]) -> str:
    """How the main rows came about."""
    return "exact" if metrics["exhaustive"] else "sampled"


def rf_class_rows(metrics: dict[str, Any]) -> tuple[list[str], list[Row]]:
    """Headings with the bounds, and the share of measurements in each class of Figure 4.4 for each policy."""
    headings = []
    for name, (low_db, high_db) in RF_CLASSES_DB.items():
        above, below = f"from {low_db:g}", f"below {high_db:g}"
        bounds = above if high_db == float("inf") else below if low_db == -float("inf") else f"{above}, {below}"
        headings.append(f"{name} ({bounds} dB)")
    rows = [
        Row(policy_line(policy).label, source_of(metrics), {name: percent(row["rf_class_share"][name]) for name in RF_CLASSES_DB})
        for policy, row in metrics["policies"].items()
        if "rf_class_share" in row
    ]
    return headings, rows


def mobility_table(metrics: dict[str, Any]) -> Table:
    """Outages in seconds and handovers for the terminal, from the payload `metrics` of `eval.nc`."""
    columns = _terminal_columns("network")
    return _terminal_table(
        title=f"sampled flights at {metrics['speed_mps']:g} m/s",
        caption="outage: longest time below the threshold; below best: SINR lost to a serving sector that is not the best",
        columns=columns,
        rows=policy_rows(metrics["policies"], source_of(metrics), columns),
    )


def text_table(metrics: dict[str, Any]) -> Table:
    """The summary for the terminal, from the payload `metrics` of `eval.nc`: this run, then the published row if there is one."""
    columns = _terminal_columns("routes")
    if metrics["exhaustive"]:
        basis = f"exact, all {count(metrics['n_pairs'])} start-goal pairs"
    else:
        basis = f"sampled from {count(metrics['n_pairs'])} start-goal pairs"
    return _terminal_table(
        title=f"{metrics.get('scenario', 'evaluation')}: {basis}",
        caption="below: steps with SINR below the threshold; p50, p90: path ratio; score: 0 = baseline, 1 = optimum",
        columns=columns,
        rows=main_rows(metrics, columns),
    )


def _terminal_columns(table: str) -> Columns:
    return {name: metric for name, metric in number_metrics().items() if metric.terminal == table}


def _terminal_table(title: str, caption: str, columns: Columns, rows: list[Row]) -> Table:
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.add_column("policy", no_wrap=True)
    for column in columns.values():
        table.add_column(column.short or column.label, justify="right", no_wrap=True)
    for row in rows:
        # Intervals stand in the report; a terminal is narrow.
        table.add_row(row.policy, *(text.split(" (")[0] for text in row.cells.values()))
    return table
