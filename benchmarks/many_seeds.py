"""Five seeds at once beside one: `python benchmarks/many_seeds.py --episodes 30000` prints the seconds of both as JSON.

A process of its own, because a device per core has to be asked for before JAX is imported.
"""

import argparse
import json
import sys
import time

N_SEEDS = 5


def main() -> None:
    """Train one seed, then five, each from nothing and with its own compilation."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--episodes", type=int, default=30_000)
    parser.add_argument("--seed", type=int, default=0, help="the first seed")
    options = parser.parse_args()

    from cellpilot.cli.devices import use_all_cores

    use_all_cores(N_SEEDS)
    import jax
    from machine import usable_cores
    from ours import thesis_case

    from cellpilot.learn.trainer import train_many

    jax.config.update("jax_enable_compilation_cache", False)
    case = thesis_case()
    seconds = {}
    for name, n_seeds in (("one_seed_s", 1), ("five_seeds_s", N_SEEDS)):
        jax.clear_caches()
        chunks = iter(range(max(1, options.episodes // case.settings.chunk_rounds)))
        seeds = range(options.seed, options.seed + n_seeds)
        began = time.perf_counter()
        train_many(case.settings, case.place, seeds, interrupted=lambda chunks=chunks: next(chunks, None) is None)
        seconds[name] = time.perf_counter() - began
    sys.stdout.write(json.dumps(seconds | {"devices": jax.local_device_count(), "cores": usable_cores()}) + "\n")


if __name__ == "__main__":
    main()
