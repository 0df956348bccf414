"""Tables of one evaluation: this run's rows beside the published ones, as data, for the terminal and for the page."""

import inspect
from typing import Any, NamedTuple

from rich.box import SIMPLE_HEAD
from rich.table import Table

from cellpilot.evaluate import METRICS
from cellpilot.evaluate.metrics import RF_CLASSES_DB
from cellpilot.report.numbers import count, percent, show
from cellpilot.report.style import policy_line
from cellpilot.report.thesis import PUBLISHED


class Column(NamedTuple):
    """A column: its heading, the kind of number, and what it means."""

    label: str
    form: str
    words: str


class Row(NamedTuple):
    """A row: the policy, how the numbers came about, and the text of each column by name."""

    policy: str
    source: str
    cells: dict[str, str]


LABELS = {
    "path_ratio_p50": "path ratio p50",
    "path_ratio_p90": "path ratio p90",
    "path_ratio_p90_failures_infinite": "path ratio p90, failures infinite",
}

WORDS = {
    "reached_share": "Share of flights that reach the goal within the cap on steps.",
    "low_sinr_share": "Share of all steps, over all flights and failed ones included, with SINR below the threshold in the cell "
    "entered. Read it beside the share that reached: circling in good cells lowers it.",
    "path_ratio_mean": "Steps flown over the steps of a shortest allowed path, mean over flights that reach the goal.",
    "path_ratio_p50": "Half of the flights that reach the goal have at most this path ratio.",
    "path_ratio_p90": "Nine tenths of the flights that reach the goal have at most this path ratio.",
    "path_ratio_p90_failures_infinite": "The same over all flights, one that fails counted as infinitely long.",
    "return_mean": "Mean sum of all rewards of a flight, without discount, up to the cap on steps.",
    "longest_outage_p90_s": "Nine tenths of the sampled flights are at most so many seconds at a time below the threshold, "
    "at the planned speed.",
    "handovers_per_km": "Handovers per kilometre of the sampled flights, after event A3: a neighbour has been stronger than the "
    "serving sector by the hysteresis for the time to trigger. Needs the received power of every sector in the map.",
    "ping_pong_share": "Share of handovers back to the sector left less than a second before.",
    "links_lost_per_km": "Cells entered per kilometre in which nothing is heard of the serving sector, as behind a corner of a "
    "ray-traced city; the drone begins anew on the strongest one.",
    "serving_loss_mean_db": "SINR of the best sector minus SINR of the serving one, mean over the cells entered by the sampled "
    "flights: what the delay of handovers costs.",
    "longest_outage_p90_steps": "Nine tenths of the flights are at most so many steps in a row below the threshold.",
}

DERIVED = {
    "regret_mean": Column("regret", "number", "Return of the exact optimum minus return of the policy, mean per flight."),
    "score": Column(
        "score",
        "score",
        "(return − return of the baseline) / (return of the optimum − return of the baseline): 0 is the baseline, 1 the optimum; "
        "not clipped, so it is negative for a policy worse than the baseline.",
    ),
}

INTERVALS = {
    "reached_share": "reached_ci95",
    "low_sinr_share": "low_sinr_ci95",
    "path_ratio_mean": "path_ratio_mean_ci95",
    "return_mean": "return_ci95",
}
"""Where the 95 % interval of a metric is kept."""

TERMINAL_COLUMNS = {
    "reached_share": "reached",
    "low_sinr_share": "below",
    "path_ratio_p50": "p50",
    "path_ratio_p90": "p90",
    "return_mean": "return",
    "regret_mean": "regret",
    "score": "score",
}
"""Columns of the table in a terminal of 80 characters, and their short headings."""


def columns() -> dict[str, Column]:
    """All columns of the summary table: every metric that is a number, then regret and score."""
    metrics = {
        name: Column(LABELS.get(name, metric.label), metric.form, WORDS.get(name) or (inspect.getdoc(metric.compute) or ""))
        for name, metric in METRICS.items()
        if metric.form != "list"
    }
    return metrics | DERIVED


def policy_rows(rows: dict[str, dict[str, Any]], source: str, names: dict[str, Column]) -> list[Row]:
    """One row per policy, with the 95 % interval behind each value that has one."""
    return [
        Row(
            policy_line(policy).label,
            source,
            {
                name: show(row.get(name), column.form) + _interval(row.get(INTERVALS.get(name, "")), column)
                for name, column in names.items()
            },
        )
        for policy, row in rows.items()
    ]


def _interval(bounds: list[float] | None, column: Column) -> str:
    if bounds is None:
        return ""
    low, high = (show(bound, column.form).removesuffix(" %") for bound in bounds)
    return f" ({low} to {high})"


def published_rows(scenario: str, names: dict[str, Column]) -> list[Row]:
    """The thesis's rows for a scenario; none for another one."""
    return [
        Row(policy, "published", {name: show(row.get(name), column.form) for name, column in names.items()})
        for policy, row in PUBLISHED.get(scenario, {}).items()
    ]


def main_rows(metrics: dict[str, Any], names: dict[str, Column]) -> list[Row]:
    """This run (exact if it is exhaustive, else sampled with intervals), then the published rows."""
    return policy_rows(metrics["policies"], source_of(metrics), names) + published_rows(str(metrics.get("scenario")), names)


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


MOBILITY_COLUMNS = {
    "longest_outage_p90_s": "outage p90 [s]",
    "handovers_per_km": "handovers/km",
    "ping_pong_share": "ping-pong",
    "links_lost_per_km": "lost/km",
    "serving_loss_mean_db": "below best [dB]",
}
"""Columns of the second table in a terminal: what the network does meanwhile."""


def mobility_table(metrics: dict[str, Any]) -> Table:
    """Outages in seconds and handovers for the terminal, from the payload `metrics` of `eval.nc`."""
    names = {name: column for name, column in columns().items() if name in MOBILITY_COLUMNS}
    return _terminal_table(
        title=f"sampled flights at {metrics['speed_mps']:g} m/s",
        caption="outage: longest time below the threshold; below best: SINR lost to a serving sector that is not the best",
        headings=[MOBILITY_COLUMNS[name] for name in names],
        rows=policy_rows(metrics["policies"], source_of(metrics), names),
    )


def text_table(metrics: dict[str, Any]) -> Table:
    """The summary for the terminal, from the payload `metrics` of `eval.nc`: this run, then the published row if there is one."""
    names = {name: column for name, column in columns().items() if name in TERMINAL_COLUMNS}
    if metrics["exhaustive"]:
        basis = f"exact, all {count(metrics['n_pairs'])} start-goal pairs"
    else:
        basis = f"sampled from {count(metrics['n_pairs'])} start-goal pairs"
    return _terminal_table(
        title=f"{metrics.get('scenario', 'evaluation')}: {basis}",
        caption="below: steps with SINR below the threshold; p50, p90: path ratio; score: 0 = baseline, 1 = optimum",
        headings=[TERMINAL_COLUMNS[name] for name in names],
        rows=main_rows(metrics, names),
    )


def _terminal_table(title: str, caption: str, headings: list[str], rows: list[Row]) -> Table:
    table = Table(title=title, caption=caption, box=SIMPLE_HEAD, collapse_padding=True, pad_edge=False)
    table.add_column("policy", no_wrap=True)
    for heading in headings:
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        # Intervals stand in the report; a terminal is narrow.
        table.add_row(row.policy, *(text.split(" (")[0] for text in row.cells.values()))
    return table
