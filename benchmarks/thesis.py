"""The three scenarios of the thesis over seeds, beside its Tables 5.1 to 5.3: trains, evaluates, writes `results.md`.

`python benchmarks/thesis.py --seeds 5 --out runs/thesis` takes about an hour on two cores; called again, it goes on where it
stopped. `--as-written` trains without clipped targets, exactly as published.
"""

import argparse
import json
import platform
import statistics
import time
from pathlib import Path
from typing import Any

import xarray as xr
from rich.console import Console

from cellpilot.cli.console import share_bar, training_bar
from cellpilot.experiment import divergence_warning
from cellpilot.provenance import versions
from cellpilot.report.thesis import PUBLISHED
from cellpilot.runs import Run, evaluate_run, open_or_create_run, read_facts, save_evaluation, stale_parts, train_run
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.storage import write_atomically

SCENARIOS = ("thesis-2d", "thesis-2d-noise", "thesis-3d")
POLICIES = ("greedy", "optimal", "optimal-undiscounted", "learned/argmax", "learned/boltzmann-0.1")
COLUMNS = {
    "reached_share": ("goal reached [%]", 100, 2),
    "low_sinr_share": ("below 3 dB [%]", 100, 2),
    "path_ratio_p50": ("p50", 1, 2),
    "path_ratio_p90": ("p90", 1, 2),
    "return_mean": ("return", 1, 3),
    "score": ("score", 1, 3),
}


def main() -> None:
    """Train and evaluate what is missing, then write the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="seeds 0..N-1 (default 5)")
    parser.add_argument("--out", type=Path, default=Path("runs/thesis"), help="folder of the runs")
    parser.add_argument("--scenarios", nargs="+", default=SCENARIOS, choices=SCENARIOS)
    parser.add_argument("--as-written", action="store_true", help="without clipped targets, exactly as published")
    options = parser.parse_args()
    lines = [f"{time.strftime('%Y-%m-%d')}, {platform.machine()}, " + ", ".join(f"{k} {v}" for k, v in versions().items()), ""]
    for name in options.scenarios:
        runs = [finished(name, seed, options.out, options.as_written) for seed in range(options.seeds)]
        lines += table(name, runs)
    suffix = "-as-written" if options.as_written else ""
    write_atomically(options.out / f"results{suffix}.md", "\n".join(lines) + "\n")
    Console().print(f"tables: {options.out / f'results{suffix}.md'}")


def finished(name: str, seed: int, out: Path, as_written: bool) -> Run:
    """The trained and evaluated run of a scenario and seed."""
    scenario = load_scenario(find_scenario(name))
    scenario = scenario.model_copy(update={"learner": scenario.learner.model_copy(update={"clip_targets": not as_written})})
    folder = out / f"{name}{'-as-written' if as_written else ''}-{seed}"
    run = open_or_create_run(folder, scenario, f"benchmarks/thesis.py, seed {seed}", seed)
    if not run.policy_file.exists():
        with training_bar(scenario.learner.episodes, "episodes", "temperature") as progress:
            if not train_run(run, progress).finished:
                raise SystemExit(130)
    if stale_parts(run) != []:
        with share_bar(f"evaluate {folder.name}") as share:
            save_evaluation(run, evaluate_run(run, progress=share))
    return run


def table(name: str, runs: list[Run]) -> list[str]:
    """Markdown of one scenario: every policy, median and range over the seeds, the published rows below."""
    rows = [metrics(run) for run in runs]
    lines = [f"## {name}", "", "| policy | " + " | ".join(label for label, _, _ in COLUMNS.values()) + " |", "|---" * 7 + "|"]
    for policy in POLICIES:
        cells = [spread([row[policy][key] for row in rows], scale, digits) for key, (_, scale, digits) in COLUMNS.items()]
        lines.append(f"| {policy} | " + " | ".join(cells) + " |")
    for published, row in PUBLISHED[name].items():
        cells = [spread([row[key]], scale, digits) if key in row else "-" for key, (_, scale, digits) in COLUMNS.items()]
        lines.append(f"| {published} | " + " | ".join(cells) + " |")
    lines += ["", "| seed | Boltzmann 0.1: reached [%] | below 3 dB [%] | p90 | arg max: reached [%] | training [s] | diverged |"]
    lines += ["|---" * 7 + "|"]
    for run, row in zip(runs, rows, strict=True):
        facts = read_facts(run.folder)
        parameters = run.parameters()
        assert parameters is not None
        diverged = "yes" if divergence_warning(parameters, run.world, run.task) else "no"
        soft, hard = row["learned/boltzmann-0.1"], row["learned/argmax"]
        ratio = "-" if soft["path_ratio_p90"] is None else f"{soft['path_ratio_p90']:.2f}"
        lines.append(
            f"| {run.seed} | {100 * soft['reached_share']:.2f} | {100 * soft['low_sinr_share']:.2f} | {ratio} | "
            f"{100 * hard['reached_share']:.2f} | {facts.train_wall_s:.0f} | {diverged} |"
        )
    return [*lines, ""]


def metrics(run: Run) -> dict[str, dict[str, Any]]:
    """Exhaustive metrics by policy."""
    with xr.open_dataset(run.folder / "eval.nc", engine="h5netcdf") as dataset:
        return dict(json.loads(dataset.attrs["metrics"])["policies"])


def spread(values: list[float | None], scale: float, digits: int) -> str:
    """Median and, where the seeds differ, range."""
    known = [scale * value for value in values if value is not None]
    if not known:
        return "-"
    middle = f"{statistics.median(known):.{digits}f}"
    low, high = f"{min(known):.{digits}f}", f"{max(known):.{digits}f}"
    return middle if low == high else f"{middle} ({low} to {high})"


if __name__ == "__main__":
    main()
