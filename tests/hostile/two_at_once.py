"""Two commands of every writing kind, started at once, over and over: both finish, or one says who holds the folder.

    python tests/hostile/two_at_once.py --times 20

Afterwards every file in the place is whole, and no temporary file is left.
"""

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from originals import make_originals

SAYS_SO = ("in use by process", "not empty", "exists already")
PASSING = (".partial-", ".replaced-", ".in-use", ".tmp")
COMMAND = (sys.executable, "-c", "import sys; from cellpilot.cli.main import main; sys.exit(main())")
KINDS = {
    "map simulate": "map simulate quick --map.points-per-side 3 --out same.nc",
    "map convert nc": "map convert m.csv same.nc",
    "map convert zarr": "map convert m.nc same.zarr",
    "map convert tif": "map convert m.nc same.tif",
    "map convert csv": "map convert m.nc same.csv",
    "map import": "map import log_30m.csv --altitude 30 --bin-m 50 --out same.nc",
    "map sites": "map sites quick --out same-sites.csv",
    "map show": "map show m.nc --out same.png",
    "map antenna": "map antenna antenna.msi --out same.png",
    "export": "export run --onnx same.onnx",
    "train": "train tiny.toml --out new --seed {i}",
    "train --force": "train tiny.toml --out run --force --seed {i}",
    "train --resume": "train --resume run",
    "run": "run tiny.toml --out new --seed {i}",
    "evaluate": "evaluate run --json",
    "report": "report run",
    "report of a shipped policy": "report thesis-2d",
    "ablation": "ablation tiny.toml --seeds 1 --out new",
    "sensitivity": "sensitivity tiny.toml --out new",
    "adapt": "adapt m.nc foreign.nc --flights 2 --seeds 1 --arms map-prior --task.threshold-db 5 --out new",
}


def once(words: str, originals: Path) -> tuple[str, list[str]]:
    """How two such commands ended, and what is wrong about it."""
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder) / "place"
        shutil.copytree(originals, place)
        calls = [[*COMMAND, *words.format(i=i).split()] for i in (1, 2)]
        both = [subprocess.Popen(c, cwd=place, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for c in calls]
        said = [process.communicate(timeout=900) for process in both]
        codes = [process.returncode for process in both]
        faults = [f"left over: {path.relative_to(place)}" for begin in PASSING for path in place.rglob(f"{begin}*")]
        for i, (code, (_, err)) in enumerate(zip(codes, said, strict=True)):
            lines = [line for line in err.splitlines() if line.startswith("cellpilot: ")]
            refused = code == 2 and len(lines) == 1 and any(words in lines[0] for words in SAYS_SO)
            if "Traceback" in err or not (code == 0 or refused):
                faults.append(f"{words.format(i=i + 1)}: exit code {code}, {err[-300:]}")
        if codes == [2, 2]:
            faults.append("nobody finished")
        faults += [fault for run in ("run", "new") for fault in _unsound(place, run, words)]
        return ("both finished" if codes == [0, 0] else "one refused"), faults


def _unsound(place: Path, run: str, words: str) -> list[str]:
    """What is not whole in a run folder afterwards: seed, state, policy and curve are of one training."""
    trains = words.startswith(("run", "train")) and "--seed" in words
    if not trains or not (place / run / "scenario.toml").exists():
        return []
    from cellpilot.runs import open_run
    from cellpilot.storage import load_netcdf

    found = open_run(place / run)
    parameters = found.parameters()
    curve = load_netcdf(place / run / "train.nc", "a curve") if (place / run / "train.nc").exists() else None
    if parameters is None or curve is None:
        return ["the training that was let in did not finish"]
    seeds = {found.seed, parameters.about["seed"], int(curve.attrs["seed"])}
    return [] if len(seeds) == 1 else [f"a folder of seeds {seeds}"]


def main() -> int:
    """Try every kind and count."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--times", type=int, default=20)
    parser.add_argument("--kinds", nargs="+", default=list(KINDS), choices=list(KINDS))
    options = parser.parse_args()
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        make_originals(Path(folder) / "originals")
        for name in options.kinds:
            ends: Counter[str] = Counter()
            for _ in range(options.times):
                end, faults = once(KINDS[name], Path(folder) / "originals")
                ends[end] += 1
                failed += bool(faults)
                for fault in faults:
                    sys.stdout.write(f"  {name}: {fault}\n")
            sys.stdout.write(f"{name}: {dict(ends)}\n")
            sys.stdout.flush()
    sys.stdout.write(f"{failed} of {options.times * len(options.kinds)} went wrong\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
