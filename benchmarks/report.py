"""What the benchmark found, as a table on the screen and as RESULTS.md: `python benchmarks/report.py RESULTS.json`."""

import json
import sys
from pathlib import Path
from statistics import median
from typing import Any

from rich.table import Table

Results = dict[str, Any]

QUANTITIES: dict[str, tuple[str, str]] = {
    "ours_total_s": ("cellpilot: whole training, compilation included", "min"),
    "ours_compile_s": ("cellpilot: compilation, part of the above", "s"),
    "ours_env_steps": ("cellpilot: environment steps flown", "count"),
    "sb3_total_s": ("SB3: whole training from its two rates, same flights in memory", "min"),
    "sb3_total_large_s": ("SB3: the same, 500,000 flown steps in memory", "min"),
    "one_seed_s": ("cellpilot: one seed, in the process of the next line", "s"),
    "five_seeds_s": ("cellpilot: five seeds at once, a device per core", "s"),
    "ours_update_s": ("cellpilot: one update, compiled", "us"),
    "torch_update_s": ("PyTorch, eager and minimal: one update", "us"),
    "sb3_update_s": ("SB3: one gradient step, same flights in memory", "us"),
    "sb3_update_large_s": ("SB3: one gradient step, 500,000 flown steps in memory", "us"),
    "sb3_step_s": ("SB3: one environment step", "us"),
    "flop_per_s": ("this machine: product of a hidden layer", "GFLOP/s"),
    "bound_update_s": ("arithmetic bound of one update", "us"),
}
"""Title and unit of everything measured in each repeat."""

RATIOS: dict[str, tuple[str, str, str]] = {
    "training_sb3_over_ours": ("whole training: SB3 / cellpilot", "sb3_total_s", "ours_total_s"),
    "training_sb3_large_over_ours": ("whole training: SB3, 500,000 steps / cellpilot", "sb3_total_large_s", "ours_total_s"),
    "update_sb3_over_ours": ("one update: SB3 / cellpilot", "sb3_update_s", "ours_update_s"),
    "update_torch_over_ours": ("one update: eager PyTorch / cellpilot", "torch_update_s", "ours_update_s"),
    "five_over_one": ("whole training: five seeds at once / one seed", "five_seeds_s", "one_seed_s"),
    "update_ours_over_bound": ("one update: cellpilot / arithmetic bound", "ours_update_s", "bound_update_s"),
}
"""Title, numerator and denominator of the ratios, each taken within one repeat."""

SCALE = {"s": 1.0, "min": 1 / 60, "us": 1e6, "GFLOP/s": 1e-9, "count": 1.0, "x": 1.0}

IDLE_LOAD, OWN_LOAD = 0.5, 1.5
"""Load averages above which others were at work: before the start, and with the benchmark itself running."""

NOTES = (
    "SB3's DQN has neither double Q-learning nor Boltzmann exploration, and its hindsight buffer leaves the terminal flag as it "
    "was: a peer in speed, not the same algorithm. Its whole training is not run but computed: updates x seconds per gradient "
    "step + the environment steps of cellpilot's training x seconds per environment step.",
    "SB3 draws from all steps in its buffer, so a fuller buffer makes a slower update; it stores each flown step once and makes "
    "hindsight goals when it samples, cellpilot stores three experiences per step. Same flights in memory means 166,666 steps.",
    "Not counted on either side: starting Python, importing, computing the radio map.",
)


def summarise(repeats: list[dict[str, float]]) -> dict[str, dict[str, float]]:
    """Median, least and greatest of every quantity and ratio over the repeats; ratios are taken within a repeat."""
    values = {name: [repeat[name] for repeat in repeats] for name in QUANTITIES}
    for name, (_, above, below) in RATIOS.items():
        values[name] = [repeat[above] / repeat[below] for repeat in repeats]
    return {name: {"median": median(all_of), "min": min(all_of), "max": max(all_of)} for name, all_of in values.items()}


def rows(results: Results) -> list[tuple[str, str, str, str]]:
    """Title, median, spread and unit of each line of the table."""
    units = {name: (title, unit) for name, (title, unit) in QUANTITIES.items()}
    units |= {name: (title, "x") for name, (title, _, _) in RATIOS.items()}
    lines = []
    for name, (title, unit) in units.items():
        low, middle, high = (_number(results["summary"][name][key] * SCALE[unit]) for key in ("min", "median", "max"))
        if results["extrapolated"] and name in ("one_seed_s", "five_seeds_s"):
            title += f" (the first {results['episodes']:,} episodes)"
        if results["extrapolated"] and name in ("ours_total_s", "ours_env_steps", "sb3_total_s", "sb3_total_large_s"):
            title += " (EXTRAPOLATED)"
        lines.append((title, middle, f"{low} - {high}", "" if unit == "count" else unit))
    return lines


def table(results: Results) -> Table:
    """The table for the screen."""
    shown = Table(title=f"{results['updates']:,} updates, {_repeats(results)}, torch threads: {results['torch_threads']}")
    shown.add_column("measured")
    shown.add_column("median", justify="right")
    shown.add_column("least - greatest", justify="right")
    shown.add_column("unit")
    for i, row in enumerate(rows(results)):
        shown.add_row(*row, end_section=i == len(QUANTITIES) - 1)
    return shown


def caveats(results: Results) -> list[str]:
    """What a reader has to know beside the numbers."""
    notes = list(NOTES)
    if results["extrapolated"]:
        notes.insert(
            0,
            f"EXTRAPOLATED from the first {results['episodes']:,} of {results['episodes_whole']:,} episodes at constant rate. "
            "Early flights are longer than later ones, so both whole trainings come out too long: not for publication.",
        )
    machine = results["machine"]
    if machine["load_before"] > IDLE_LOAD or machine["load_highest"] > OWN_LOAD:
        notes.insert(
            0,
            f"BUSY MACHINE: load average {machine['load_before']:.2f} before the start, {machine['load_highest']:.2f} at its "
            "highest. Load slows the sides unequally, so even the ratios are off: repeat it on an idle machine.",
        )
    return notes


def markdown(results: Results) -> str:
    """RESULTS.md: the command, machine, date, versions, medians and spread."""
    machine = results["machine"]
    versions = ", ".join(f"{name} {version}" for name, version in results["versions"].items())
    body = "\n".join(f"| {' | '.join(row)} |" for row in rows(results))
    return (
        "\n\n".join(
            [
                "# Results of the speed benchmark",
                "Generated by `benchmarks/report.py` from the JSON beside it; what is measured: [README.md](README.md).",
                f"* command: `{results['command']}`\n"
                f"* machine: {machine['cpu']}, {machine['cores']} cores, {machine['system']}; load average before the start "
                f"{machine['load_before']:.2f}, highest {machine['load_highest']:.2f}\n"
                f"* date: {results['date']}, {results['minutes']:.0f} minutes in all\n"
                f"* versions: {versions}\n"
                f"* torch threads: {results['torch_threads']} (the fastest of those tried); "
                f"{results['flop_per_update'] / 1e6:.2f} MFLOP per update; {_repeats(results)}",
                f"| measured | median | least - greatest of {results['repeats']} | unit |\n|---|---:|---:|---|\n{body}",
                *caveats(results),
            ]
        )
        + "\n"
    )


def _repeats(results: Results) -> str:
    return "1 repeat" if results["repeats"] == 1 else f"{results['repeats']} repeats, each with its own seed"


def _number(value: float) -> str:
    """Three significant digits, thousands separated."""
    digits = 2 if value < 10 else 1 if value < 100 else 0
    return f"{value:,.{digits}f}"


if __name__ == "__main__":
    if len(sys.argv) != 2 or not Path(sys.argv[1]).is_file():
        sys.exit("usage: python benchmarks/report.py RESULTS.json (a file that benchmarks/bench.py wrote)")
    source = Path(sys.argv[1])
    source.with_suffix(".md").write_text(markdown(json.loads(source.read_text())))
