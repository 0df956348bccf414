"""How time, memory and quality grow with the grid and with the number of seeds, for each learner.

Usage: python benchmarks/scaling.py [--sides 20 40 80 160] [--seeds 1 5 20] [--learners ...] [--out SCALING.json]

The thesis's area of 400 m x 400 m in ever smaller cells: the map has the same good and bad areas, flights get longer.
Every point is a process of its own, so that its peak memory is its own. A point of time trains for a few chunks and extrapolates
the rest at constant rate (labelled so); a point of quality trains one seed until it is finished or its time is over.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from machine import cpu_name, usable_cores

SIDES, SEEDS = (20, 40, 80, 160), (1, 5, 20)
AREA_M = 400.0
CHUNKS = 4
"""Chunks that a point of time measures after the first, which warms up."""
TIME_BUDGET_S, QUALITY_BUDGET_S = 60.0, 240.0
"""A point of time stops after the chunk in which this is over; a point of quality stops training."""
LIMIT_S = 1_200.0
"""A point that takes longer is given up and marked so."""
GOALS = 64
"""Goals drawn for the figures of quality, from every start; all 400 on the smallest grid."""


@dataclass(frozen=True)
class Learner:
    """A scenario whose learner is measured, and the rounds in a chunk."""

    scenario: str
    chunk_rounds: int


LEARNERS = {
    "ddqn-her": Learner("thesis-2d", 25),
    "fqi-her": Learner("exact-2d", 2),
}


def main() -> int:
    """Measure every point in a process of its own, show and write the tables."""
    arguments = _arguments()
    if arguments.point:
        kind, learner, side, n_seeds = arguments.point
        point = {"time": time_point, "quality": quality_point}[kind](LEARNERS[learner], int(side), int(n_seeds), arguments)
        sys.stdout.write(json.dumps(point) + "\n")
        return 0
    from rich.console import Console

    from cellpilot.provenance import versions
    from cellpilot.storage import write_atomically

    console = Console(soft_wrap=True)
    wanted = [("time", *p) for p in _points(arguments.learners, arguments.sides, arguments.seeds)]
    wanted += [("quality", *p) for p in _points(arguments.learners, arguments.sides, [1])]
    points: list[dict[str, Any]] = []
    for kind, learner, side, n_seeds in wanted:
        name = {"kind": kind, "learner": learner, "side": side, "seeds": n_seeds}
        points.append(name | measure(kind, learner, side, n_seeds, arguments))
        console.print(json.dumps(points[-1]))
    results = {
        "command": "python benchmarks/" + " ".join([Path(sys.argv[0]).name, *sys.argv[1:]]),
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "machine": {"cpu": cpu_name(), "cores": usable_cores(), "load": os.getloadavg()[0]},
        "versions": versions(),
        "points": points,
    }
    text = markdown(results)
    console.print(text)
    if arguments.out:
        write_atomically(arguments.out, json.dumps(results, indent=2) + "\n")
        write_atomically(arguments.out.with_suffix(".md"), text)
    return 0


def measure(kind: str, learner: str, side: int, n_seeds: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """One point in its own process; `failed` says why there are no figures."""
    budgets = ["--time-budget", str(arguments.time_budget), "--quality-budget", str(arguments.quality_budget)]
    command = [sys.executable, __file__, "--point", kind, learner, str(side), str(n_seeds), *budgets]
    environment = dict(os.environ)
    if n_seeds > 1:
        environment.setdefault("XLA_FLAGS", f"--xla_force_host_platform_device_count={min(usable_cores(), n_seeds)}")
    try:
        done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=LIMIT_S, check=False)
    except subprocess.TimeoutExpired:
        return {"failed": f"more than {LIMIT_S:.0f} s"}
    if done.returncode:
        return {"failed": (done.stderr.strip().splitlines() or ["killed"])[-1][:200]}
    return dict(json.loads(done.stdout.splitlines()[-1]))


@dataclass(frozen=True)
class Case:
    """What is trained on a grid."""

    world: Any
    task: Any
    settings: Any
    place: Any


def make_case(learner: Learner, side: int) -> Case:
    """The learner's scenario with `side` cells along each side of the area; the points simulated are the same on every grid."""
    from cellpilot.experiment import build_map, make_task
    from cellpilot.learn.learner import Place
    from cellpilot.scenario import find_scenario, load_scenario
    from cellpilot.world import World

    scenario = load_scenario(find_scenario(learner.scenario))
    map_settings = scenario.map.model_copy(update={"bin_m": AREA_M / side, "points_per_side": max(1, 160 // side)})
    world = World.from_map(build_map(map_settings), scenario.task.noise_std_db)
    task = make_task(scenario.task, world.grid)
    return Case(world, task, scenario.learner, Place(world, task))


def time_point(learner: Learner, side: int, n_seeds: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Seconds per round and update, seconds of the whole training by extrapolation, and peak memory."""
    from cellpilot.learn.trainer import train_many

    case = make_case(learner, side)
    before_mb, began = _peak_mb(), time.perf_counter()
    marks: list[float] = []
    results = train_many(
        case.settings,
        case.place,
        range(n_seeds),
        chunk_rounds=learner.chunk_rounds,
        progress=lambda p: marks.append(time.perf_counter()),
        interrupted=lambda: len(marks) > CHUNKS or time.perf_counter() - began > arguments.time_budget + _compile_s(marks, began),
    )
    chunks = np.diff(marks) if len(marks) > 1 else np.array([results[0].train_wall_s])
    round_s = median(chunks.tolist()) / learner.chunk_rounds
    settings = case.settings
    first_chunk_s = results[0].train_wall_s - float(chunks.sum()) if len(marks) > 1 else results[0].train_wall_s
    return {
        "compile_s": results[0].compile_s,
        "round_s": round_s,
        "update_us": 1e6 * round_s * settings.n_rounds / settings.updates / n_seeds,
        "whole_s": results[0].compile_s + max(0.0, first_chunk_s - round_s * learner.chunk_rounds) + round_s * settings.n_rounds,
        "spread": float((chunks.max() - chunks.min()) / median(chunks.tolist())),
        "rounds_timed": len(chunks) * learner.chunk_rounds,
        "rounds": settings.n_rounds,
        "counts": settings.counts,
        "peak_mb": _peak_mb(),
        "before_mb": before_mb,
    }


def quality_point(learner: Learner, side: int, n_seeds: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Score and share reached by arg max, trained in full or until the budget is spent."""
    from cellpilot.evaluate.exact import exhaustive_summary
    from cellpilot.evaluate.metrics import METRICS, reached_share, score
    from cellpilot.learn.trainer import train_one
    from cellpilot.policies import GreedyPolicy, LearnedPolicy, OptimalPolicy

    case = make_case(learner, side)
    began = time.perf_counter()
    over = lambda: time.perf_counter() - began > arguments.quality_budget
    result = train_one(case.settings, case.place, n_seeds - 1, interrupted=over)
    seconds = time.perf_counter() - began
    world, task = case.world, case.task
    about = {"task": task.as_dict()}
    learned = LearnedPolicy(result.policy_parameters(about), world.grid)
    free = world.airspace.free_cells
    goals = free if side <= min(SIDES) else np.sort(np.random.default_rng(0).choice(free, GOALS, replace=False))
    policies = (GreedyPolicy(world), OptimalPolicy(world, task), learned)
    greedy, optimal, found = (exhaustive_summary(None, world, task, policy, goals=goals) for policy in policies)
    return {
        "seconds": seconds,
        "share_trained": len(result.history["reached"]) / case.settings.n_rounds,
        "env_steps": result.env_steps,
        "score": score(found, greedy, optimal),
        "reached_share": reached_share(found),
        "path_ratio_p90": METRICS["path_ratio_p90"].compute(found),
        "optimal_path_ratio_p90": METRICS["path_ratio_p90"].compute(optimal),
        "goals": len(goals),
        "peak_mb": _peak_mb(),
    }


def markdown(results: dict[str, Any]) -> str:
    """Both tables with the command, machine, date and versions."""
    machine = results["machine"]
    scenarios = " and ".join(f"`{learner.scenario}` ({name})" for name, learner in LEARNERS.items())
    times, qualities = (
        "\n".join(row(point) for point in results["points"] if point["kind"] == kind)
        for kind, row in (("time", time_row), ("quality", quality_row))
    )
    return f"""\
# Growth of time, memory and quality

* command: `{results["command"]}`
* machine: {machine["cpu"]}, {machine["cores"]} cores; load average at the end {machine["load"]:.2f}
* date: {results["date"]}
* versions: {", ".join(f"{name} {version}" for name, version in results["versions"].items())}

The area of {AREA_M:.0f} m x {AREA_M:.0f} m in side x side cells, otherwise the scenarios {scenarios}.
Each point is a process of its own; peak memory is that of the whole process, Python and libraries included.

## Time and memory

Whole training: EXTRAPOLATED at constant rate from the first rounds (median of up to {CHUNKS} chunks; spread = (slowest -
fastest) / median), compilation included. Flights get shorter as a learner learns, so ddqn-her takes less than this.

| learner | side | cells | seeds | compile [s] | update and seed [us] | whole training [s] | spread | peak memory [MB] |
|---|---:|---:|---:|---:|---:|---:|---:|---:|
{times}

## Quality

Arg max of one seed (0), exact over every start and all goals on the smallest grid, {GOALS} drawn goals on the others.
Score: 0 is the baseline, 1 the optimum. Trained: share of the scenario's training that the time allowed.

| learner | side | trained | seconds | score | goal reached | path ratio p90 (optimum) | steps flown |
|---|---:|---:|---:|---:|---:|---:|---:|
{qualities}
"""


def time_row(point: dict[str, Any]) -> str:
    """One line of the first table."""
    cells = [point["learner"], str(point["side"]), f"{point['side'] ** 2:,}", str(point["seeds"])]
    if "failed" in point:
        return _row([*cells, point["failed"], "", "", "", ""])
    figures = [f"{point['compile_s']:.1f}", f"{point['update_us']:.1f}", f"{point['whole_s']:,.0f}"]
    return _row([*cells, *figures, f"{100 * point['spread']:.0f} %", f"{point['peak_mb']:,.0f}"])


def quality_row(point: dict[str, Any]) -> str:
    """One line of the second table."""
    cells = [point["learner"], str(point["side"])]
    if "failed" in point:
        return _row([*cells, point["failed"], "", "", "", "", ""])
    ratio, score = ("-" if point[name] is None else f"{point[name]:.3f}" for name in ("path_ratio_p90", "score"))
    reached, best = f"{100 * point['reached_share']:.2f} %", f"{point['optimal_path_ratio_p90']:.3f}"
    trained = [f"{100 * point['share_trained']:.0f} %", f"{point['seconds']:.0f}"]
    return _row([*cells, *trained, score, reached, f"{ratio} ({best})", f"{point['env_steps']:,}"])


def _row(cells: list[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _compile_s(marks: list[float], began: float) -> float:
    """Until the first chunk is done its time counts as compilation, which the budget leaves out."""
    return (marks[0] if marks else time.perf_counter()) - began


def _points(learners: list[str], sides: list[int], seeds: list[int]) -> list[tuple[str, int, int]]:
    return [(learner, side, n_seeds) for learner in learners for side in sides for n_seeds in seeds]


def _peak_mb() -> float:
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return peak / (1024 if sys.platform != "darwin" else 1024**2)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides", type=int, nargs="+", default=list(SIDES), help="cells a side")
    parser.add_argument("--seeds", type=int, nargs="+", default=list(SEEDS), help="seeds trained at once")
    parser.add_argument("--learners", nargs="+", default=list(LEARNERS), choices=list(LEARNERS))
    parser.add_argument("--time-budget", type=float, default=TIME_BUDGET_S, help="seconds of a point of time")
    parser.add_argument("--quality-budget", type=float, default=QUALITY_BUDGET_S, help="seconds of training for quality")
    parser.add_argument("--out", type=Path, help="JSON to write, with the .md beside it (in full: benchmarks/SCALING.json)")
    parser.add_argument("--point", nargs=4, help=argparse.SUPPRESS)
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
