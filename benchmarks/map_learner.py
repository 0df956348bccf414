"""The learner of the map over seeds on the three scenarios of the thesis: writes `map_learner.json` and `MAP_LEARNER.md`.

`python benchmarks/map_learner.py` takes about forty minutes on one core, nearly all of it three-dimensional: each of 6 x 20
posteriors there is evaluated on all 3,998,000 start-goal pairs. Seeds that are in the JSON file are not flown again.
"""

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from machine import cpu_name, usable_cores
from rich.console import Console

from cellpilot.evaluate.exact import exhaustive_summary
from cellpilot.evaluate.metrics import METRICS, reached_share, score
from cellpilot.experiment import build_map, make_task
from cellpilot.learn.algorithms.map_learner import MapLearner, learn_map
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.policies import GreedyPolicy, OptimalPolicy
from cellpilot.provenance import versions
from cellpilot.scenario import find_scenario, load_scenario
from cellpilot.storage import write_atomically
from cellpilot.task import Task
from cellpilot.world import World

SCENARIOS = {"thesis-2d": (30, 0.97), "thesis-2d-noise": (50, 0.93), "thesis-3d": (150, 0.93)}
"""Scenario -> flights and the mean score that must be reached after them."""
CHECKPOINTS = (1, 3, 5, 10, 20, 30, 50, 100, 150)
CHECKPOINTS_3D = (1, 10, 30, 50, 100, 150)
"""Fewer, since a posterior there is evaluated on ten times as many goals."""
REPLAN_LIMIT_MS = 50.0

Row = dict[str, Any]


def main() -> None:
    """Fly what is missing, then write table and JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=20, help="seeds 0..N-1 (default 20)")
    parser.add_argument("--scenarios", nargs="+", default=list(SCENARIOS), choices=list(SCENARIOS))
    parser.add_argument("--exploration", default="optimism", choices=["optimism", "thompson"])
    parser.add_argument("--out", type=Path, default=Path(__file__).parent, help="folder of the results")
    options = parser.parse_args()
    settings = MapLearning(exploration=options.exploration)
    suffix = "" if options.exploration == "optimism" else f"_{options.exploration}"
    file = options.out / f"map_learner{suffix}.json"
    results: dict[str, Any] = json.loads(file.read_text()) if file.is_file() else {"settings": repr(settings), "scenarios": {}}
    if results["settings"] != repr(settings):
        parser.error(f"{file} was flown with other settings; move it away")
    console = Console(soft_wrap=True)
    for name in options.scenarios:
        known = results["scenarios"].setdefault(name, {"seeds": {}})
        for seed in range(options.seeds):
            if str(seed) not in known["seeds"]:
                known |= fly(name, settings, seed, known["seeds"])
                write(file, results, options.seeds)
                last = known["seeds"][str(seed)][-1]
                console.print(f"{name} seed {seed}: score {last['score']:.3f} after {last['flights']} flights")
    write(file, results, options.seeds)
    text = markdown(results)
    write_atomically(options.out / f"MAP_LEARNER{suffix.upper()}.md", text)
    console.print(text)


def write(file: Path, results: dict[str, Any], seeds: int) -> None:
    """The JSON file with its provenance."""
    results |= {
        "command": f"python benchmarks/map_learner.py --seeds {seeds}",
        "date": time.strftime("%Y-%m-%d %H:%M UTC", time.gmtime()),
        "machine": {"cpu": cpu_name(), "cores": usable_cores(), "system": platform.system()},
        "versions": versions(),
    }
    write_atomically(file, json.dumps(results, separators=(",", ":")) + "\n")


_YARDSTICKS: dict[str, tuple[World, Task, Any, Any]] = {}


def fly(name: str, settings: MapLearning, seed: int, seeds: dict[str, list[Row]]) -> dict[str, Any]:
    """One seed: figures at every checkpoint, over all pairs."""
    if name not in _YARDSTICKS:
        scenario = load_scenario(find_scenario(name))
        world = World.from_map(build_map(scenario.map), scenario.task.noise_std_db)
        task = make_task(scenario.task, world.grid)
        yardsticks = (exhaustive_summary(None, world, task, p) for p in (GreedyPolicy(world), OptimalPolicy(world, task)))
        _YARDSTICKS[name] = (world, task, *yardsticks)
    world, task, greedy, optimal = _YARDSTICKS[name]
    rows: list[Row] = []
    started, evaluating_s = time.perf_counter(), 0.0
    checkpoints = CHECKPOINTS if world.grid.sides[2] == 1 else CHECKPOINTS_3D
    for learner in learn_map(world, task, settings, seed, checkpoints):
        before = time.perf_counter()
        figures = exhaustive_summary(None, world, task, learner.policy())
        evaluating_s += time.perf_counter() - before
        kernel = learner.posterior.kernel
        rows.append(
            {
                "flights": learner.n_flights,
                "steps": len(learner.measured_cells),
                "score": score(figures, greedy, optimal),
                "reached_share": reached_share(figures),
                "path_ratio_p90": METRICS["path_ratio_p90"].compute(figures),
                "noise_std_db": kernel.noise_std_db,
                "std_db": kernel.std_db,
                "length_m": kernel.length_m,
                "vertical_length_m": kernel.vertical_length_m,
            }
        )
    flying_s = time.perf_counter() - started - evaluating_s
    return {
        "seeds": seeds | {str(seed): rows},
        "cells": world.grid.n_cells,
        "flying_s": flying_s,
        "evaluating_s": evaluating_s,
    } | replan_times(learner, world, seed)


def replan_times(learner: MapLearner, world: World, seed: int) -> dict[str, float]:
    """Median milliseconds of one plan for one goal, and of one measurement taken into the posterior."""
    rng = np.random.default_rng(seed)
    goals = rng.choice(world.airspace.free_cells, 20)

    def median_ms(act: Callable[[int], object]) -> float:
        times = []
        for goal in goals:
            before = time.perf_counter()
            act(int(goal))
            times.append(time.perf_counter() - before)
        return float(1e3 * np.median(times))

    return {
        "plan_ms": median_ms(lambda goal: learner.plan(goal, rng)),
        "update_ms": median_ms(lambda cell: learner.posterior.update([cell], [0.0])),
    }


def markdown(results: dict[str, Any]) -> str:
    """The page of results."""
    machine = results["machine"]
    lines = [
        "# Results of the map learner",
        "",
        "Generated by `benchmarks/map_learner.py` from the JSON beside it; what it is:",
        "[docs/map_learner.md](../docs/map_learner.md). Score over all start-goal pairs of the true world, failures",
        "included: 0 = greedy baseline, 1 = exact optimum at the task's",
        "discount. Plans are undiscounted, as the score is, so slightly more than 1 is possible.",
        "",
        f"* command: `{results['command']}`",
        f"* machine: {machine['cpu']}, {machine['cores']} cores, {machine['system']}; one core used",
        f"* date: {results['date']}",
        f"* versions: {', '.join(f'{k} {v}' for k, v in results['versions'].items())}",
        f"* settings: `{results['settings']}`",
        "",
    ]
    for name, facts in results["scenarios"].items():
        lines += table(name, facts)
    return "\n".join(lines)


def table(name: str, facts: dict[str, Any]) -> list[str]:
    """Spread over seeds at each checkpoint, and the promises beside what was found."""
    seeds = list(facts["seeds"].values())
    lines = [
        f"## {name} ({facts['cells']:,} cells, {len(seeds)} seeds)",
        "",
        "| flights | steps, mean | score mean | min | max | sd | reached, least | p90 path ratio, mean | noise estimated [dB] |",
        "|---:|---:|---:|---:|---:|---:|---:|---:|---:|",
    ]
    for rows in zip(*seeds, strict=True):
        scores = np.array([row["score"] for row in rows])
        mean = {key: np.mean([row[key] for row in rows]) for key in ("steps", "path_ratio_p90", "noise_std_db")}
        reached = min(row["reached_share"] for row in rows)
        spread = scores.std(ddof=1) if len(scores) > 1 else 0.0
        lines.append(
            f"| {rows[0]['flights']} | {mean['steps']:,.0f} | {scores.mean():.3f} | {scores.min():.3f} | {scores.max():.3f} "
            f"| {spread:.3f} | {100 * reached:.2f} % | {mean['path_ratio_p90']:.2f} | {mean['noise_std_db']:.2f} |"
        )
    flights, least = SCENARIOS[name]
    found = float(np.mean([row["score"] for rows in seeds for row in rows if row["flights"] == flights]))
    verdict = "met" if found >= least else "MISSED"
    speed = "met" if facts["plan_ms"] < REPLAN_LIMIT_MS else "MISSED"
    lines += [
        "",
        f"Wanted: mean score >= {least} after {flights} flights: {verdict} ({found:.3f}).",
        f"One plan for one goal: {facts['plan_ms']:.1f} ms (wanted below {REPLAN_LIMIT_MS:.0f} at 2,000 cells: {speed}); one "
        f"measurement into the posterior: {facts['update_ms']:.1f} ms. The last seed flew {seeds[0][-1]['flights']} flights in "
        f"{facts['flying_s']:.0f} s; evaluating {len(seeds[0])} posteriors on all pairs took {facts['evaluating_s']:.0f} s.",
        "",
    ]
    return lines


if __name__ == "__main__":
    main()
