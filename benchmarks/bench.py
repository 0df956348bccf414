"""The speed benchmark: cellpilot, Stable-Baselines3, eager PyTorch and the arithmetic bound, measured in one run.

Usage: python benchmarks/bench.py [--repeats 5] [--episodes 30000] [--out RESULTS.json]
"""

import argparse
import importlib.util
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from statistics import mean, median

from machine import cpu_name, usable_cores

EXTRA = {"stable_baselines3": "stable-baselines3", "gymnasium": "gymnasium", "torch": "torch"}
REPEATS, EPISODES = 5, 30_000
SLICES = 10
"""Parts of one training; after each part every other measurement gets its turn, so noise of the machine hits all alike."""

ROUNDS = {
    "ours_update_s": 100,  # x 30 updates, in each slice
    "torch_update_s": 10,
    "sb3_update_s": 4,
    "sb3_update_large_s": 4,
    "sb3_step_s": 1_000,  # steps
    "flop_per_s": 3_000,  # products
}

Measurement = Callable[[], float]


def main() -> int:
    """Run everything, show the table, write the files; 0, or 2 where something is missing or wrong."""
    arguments = _arguments()
    missing = [name for module, name in EXTRA.items() if importlib.util.find_spec(module) is None]
    if missing:
        sys.stderr.write(f"bench: {', '.join(missing)} not installed; expected the extra `bench`: pip install -e '.[bench]'\n")
        return 2

    import torch  # the extra is known to be there only now
    from ours import flop_per_update, thesis_case
    from rich.console import Console

    import report
    from cellpilot.provenance import versions
    from cellpilot.storage import write_atomically

    console = Console()
    began, loads = time.perf_counter(), [os.getloadavg()[0]]
    case = thesis_case()
    measurements = prepare(console.print)
    threads = fastest_threads(measurements)
    torch.set_num_threads(threads)
    console.print(f"torch runs on {threads} thread(s)")

    flop = flop_per_update(case.layer_sizes, case.settings.batch_size)
    repeats = []
    for seed in range(arguments.repeats):
        console.print(f"repeat {seed + 1} of {arguments.repeats}: {arguments.episodes:,} episodes, the others in between ...")
        repeats.append(measure_once(measurements, seed, arguments.episodes, flop) | many_seeds(seed, arguments.episodes))
        loads.append(os.getloadavg()[0])
        total_s, peer_s = repeats[-1]["ours_total_s"], repeats[-1]["sb3_total_s"]
        console.print(f"  cellpilot {total_s:.1f} s, SB3 {peer_s / 60:.1f} min, ratio {peer_s / total_s:.1f}")

    results: report.Results = {
        "command": f"python benchmarks/bench.py --repeats {arguments.repeats} --episodes {arguments.episodes}",
        "date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "minutes": (time.perf_counter() - began) / 60,
        "machine": {
            "cpu": cpu_name(),
            "cores": usable_cores(),
            "system": platform.system(),
            "load_before": loads[0],
            "load_highest": max(loads),
        },
        "versions": versions() | {name: version(name) for name in ("jaxlib", *EXTRA.values())},
        "repeats": arguments.repeats,
        "episodes": arguments.episodes,
        "episodes_whole": case.settings.episodes,
        "extrapolated": arguments.episodes < case.settings.episodes,
        "updates": case.updates,
        "torch_threads": threads,
        "flop_per_update": flop,
        "summary": report.summarise(repeats),
        "values": repeats,
    }
    console.print(report.table(results))
    for note in report.caveats(results):
        console.print(note)
    if arguments.out is None:
        console.print("a shortened run: nothing written (give --out to keep it)")
        return 0
    write_atomically(arguments.out, json.dumps(results, indent=2) + "\n")
    write_atomically(arguments.out.with_suffix(".md"), report.markdown(results))
    console.print(f"written: {arguments.out} and {arguments.out.with_suffix('.md').name}")
    return 0


def prepare(say: Callable[[str], None]) -> dict[str, Measurement]:
    """Everything that is measured in slices, compiled and filled, each run once to warm up."""
    import jax
    import torch
    from ours import make_matrix_product, make_update, thesis_case
    from sb3_run import make_peer, make_sb3_step, make_sb3_update
    from torch_update import make_torch_update

    jax.config.update("jax_enable_compilation_cache", False)  # every training pays its compilation
    torch.set_num_threads(1)  # until the fastest is known: two threads on a busy machine can be fifty times slower
    case = thesis_case()
    say("cellpilot: filling the memory and compiling the update alone")
    ours_update = make_update(case, ROUNDS["ours_update_s"])
    matrix_product = make_matrix_product(case, ROUNDS["flop_per_s"])
    say("SB3: filling two hindsight buffers by random flights")
    peer = make_peer(case)
    measurements = {
        "ours_update_s": ours_update,
        "torch_update_s": make_torch_update(case, ROUNDS["torch_update_s"]),
        "sb3_update_s": make_sb3_update(peer, peer.same_flights, case, ROUNDS["sb3_update_s"]),
        "sb3_update_large_s": make_sb3_update(peer, peer.same_number, case, ROUNDS["sb3_update_large_s"]),
        "sb3_step_s": make_sb3_step(peer, ROUNDS["sb3_step_s"]),
        "flop_per_s": matrix_product,
    }
    say("warming up")
    for measure in measurements.values():
        measure()
    return measurements


def fastest_threads(measurements: dict[str, Measurement]) -> int:
    """The number of torch threads, one or all cores, with the faster gradient step in SB3 (median of five, in turn)."""
    import torch

    seconds: dict[int, list[float]] = {1: [], usable_cores(): []}
    for _ in range(5):
        for threads, taken in seconds.items():
            torch.set_num_threads(threads)
            taken.append(measurements["sb3_update_s"]())
    return min(seconds, key=lambda threads: median(seconds[threads]))


def measure_once(measurements: dict[str, Measurement], seed: int, episodes: int, flop: int) -> dict[str, float]:
    """One training from start to end and, between its slices, one block of everything else; a block is the mean of its parts."""
    from ours import thesis_case, train_in_slices

    case = thesis_case()
    blocks: dict[str, list[float]] = {name: [] for name in measurements}
    for training in train_in_slices(case, seed, episodes, SLICES):
        for name, measure in measurements.items():
            blocks[name].append(measure())
        total_s, env_steps = training.whole(case.settings.episodes)
        compile_s = training.compile_s
    found = {name: mean(parts) for name, parts in blocks.items()}
    found |= {
        "ours_total_s": total_s,
        "ours_compile_s": compile_s,
        "ours_env_steps": env_steps,
        "bound_update_s": flop / found["flop_per_s"],
    }
    for name in ("", "_large"):
        found[f"sb3_total{name}_s"] = case.updates * found[f"sb3_update{name}_s"] + env_steps * found["sb3_step_s"]
    return found


def many_seeds(seed: int, episodes: int) -> dict[str, float]:
    """Seconds of one and of five trainings at once, in a process of its own with a device per core."""
    command = [sys.executable, str(Path(__file__).with_name("many_seeds.py")), "--seed", str(seed), "--episodes", str(episodes)]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    return {name: found[name] for name in ("one_seed_s", "five_seeds_s")}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description="Measure cellpilot's training against its peers, as ratios within one run.")
    parser.add_argument("--repeats", type=int, default=REPEATS, help="trainings, each with its own seed (default 5)")
    parser.add_argument("--episodes", type=int, default=EPISODES, help="fewer than 30000 extrapolates, for a quick look")
    parser.add_argument("--out", type=Path, help="JSON to write, with the .md beside it (run in full: RESULTS.json)")
    arguments = parser.parse_args()
    if arguments.repeats < 1 or not SLICES <= arguments.episodes <= EPISODES:
        parser.error(f"expected --repeats of at least 1 and --episodes from {SLICES} to {EPISODES}")
    if arguments.out is None and arguments.repeats >= REPEATS and arguments.episodes == EPISODES:
        arguments.out = Path(__file__).parent / "RESULTS.json"
    return arguments


if __name__ == "__main__":
    sys.exit(main())
