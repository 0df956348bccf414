"""How long simulated maps take: the default 3D map at 5 m sampling, and a town of 10 km x 10 km with all of its sectors.

Usage: python benchmarks/simulation.py [--sides-m 2500 5000 10000] [--repeats 3]

Every size is a process of its own, so that its peak memory is its own: heights 20, 40, ..., 100 m, cells of 20 m, one point a
cell, three-sector sites every 500 m that cover the area (469 of them on 10 km x 10 km). The exponents say how the time grows
with the number of links (cells times sites). The largest size runs once, the others `--repeats` times.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from statistics import median

import numpy as np
from machine import cpu_name, usable_cores

HEIGHTS_M = (20.0, 40.0, 60.0, 80.0, 100.0)
RINGS = {2500.0: 3, 5000.0: 6, 10000.0: 12}
"""Rings of sites that cover a square of this side: 37, 127 and 469 sites."""


def main() -> None:
    """Measure each size in a process of its own and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sides-m", type=float, nargs="+", default=sorted(RINGS), choices=sorted(RINGS), metavar="SIDE")
    parser.add_argument("--repeats", type=int, default=3, help="runs of each size but the largest")
    parser.add_argument("--point", type=float, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.point is not None:
        sys.stdout.write(json.dumps(point(options.point)) + "\n")
        return
    from rich.console import Console

    console = Console(soft_wrap=True, highlight=False)
    console.print(f"{cpu_name()}, {usable_cores()} cores, load {os.getloadavg()[0]:.1f}")
    links, seconds = [], []
    for side_m in [0.0, *options.sides_m]:
        runs = [measure(side_m) for _ in range(1 if side_m == max(options.sides_m) else options.repeats)]
        first, times_s = runs[0], [run["seconds"] for run in runs]
        spread = f" ({min(times_s):.2f} to {max(times_s):.2f})" if len(times_s) > 1 else ""
        name = f"{side_m / 1000:g} km x {side_m / 1000:g} km, one point a cell" if side_m else "default 3D map at 5 m sampling"
        console.print(
            f"{name}: {first['cells']:,} cells, {first['sites']} sites: {median(times_s):.2f} s{spread},"
            f" at most {max(run['peak_gb'] for run in runs):.2f} GB"
        )
        if side_m:
            links.append(first["cells"] * first["sites"])
            seconds.append(median(times_s))
    if len(seconds) > 1:
        steps = np.diff(np.log(seconds)) / np.diff(np.log(links))
        console.print(f"time grows with the links to the power of {', '.join(f'{step:.2f}' for step in steps)}")


def measure(side_m: float) -> dict[str, float]:
    """One map in its own process."""
    done = subprocess.run([sys.executable, __file__, "--point", str(side_m)], capture_output=True, text=True, check=True)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def point(side_m: float) -> dict[str, float]:
    """Seconds, cells, sites and peak memory of one map; side 0 is the default 3D map in points 5 m apart."""
    from cellpilot.maps import simulate_map
    from cellpilot.radio import hexagonal_deployment

    half_m, per_side = (side_m / 2, 1) if side_m else (200.0, 4)
    deployment = hexagonal_deployment(rings=RINGS[side_m] if side_m else 1)
    area = {"x_range_m": (-half_m, half_m), "y_range_m": (-half_m, half_m), "heights_m": HEIGHTS_M}
    began = time.perf_counter()
    radio_map = simulate_map(deployment, **area, points_per_side=per_side)
    seconds = time.perf_counter() - began
    peak_gb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024**2
    return {"seconds": seconds, "cells": radio_map["sinr_db"].size, "sites": len(np.unique(deployment.site)), "peak_gb": peak_gb}


if __name__ == "__main__":
    main()
