"""A seeded campaign of damaged and hostile files against every command that reads one.

    python tests/hostile/campaign.py --inputs 1000 --seed 0 --folder /tmp/campaign

Every input ends in exit code 0 or 1 with an output, or 2 with one line; no traceback, nothing over 20 s or 2 GB; and where
cellpilot wrote a checksum, nothing is read that is not what was written. One line of JSON an input goes to `results.jsonl`.
"""

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from mutations import mutate
from originals import KINDS, Kind, make_originals

MOST_CPU_S = 20.0
MOST_BYTES = 2_000_000_000
PATIENCE_S = 120.0
EXPECTED = ("cellpilot: ", "warning: ", "trained in", "eval.nc was", "evaluate ")
"""How the lines on standard error begin."""


def attack(originals: Path, seed: int, number: int) -> dict[str, Any]:
    """Make input `number` of the campaign, let its command read it, and say how that ended."""
    rng = np.random.default_rng([seed, number])
    name = list(KINDS)[number % len(KINDS)]
    kind = KINDS[name]
    with tempfile.TemporaryDirectory() as place:
        file = _place(originals, Path(place), kind)
        victims = [path for path in sorted(file.rglob("*")) if path.is_file()] if file.is_dir() else [file]
        victim = victims[int(rng.integers(len(victims)))]
        if file.is_dir() and rng.random() < 0.1:
            victim.unlink()
        else:
            victim.write_bytes(mutate(rng, victim.read_bytes()))
        words = [word.format(file=file, run=file.parent) for word in kind.command]
        before_s = time.process_time()
        code, out, err = _call(words, Path(place))
        result = {"number": number, "kind": name, "file": victim.name, "code": code, "error": err[-500:]}
        result["cpu_s"] = round(time.process_time() - before_s, 2)
        result["peak_bytes"] = _peak_bytes()
        result["verdict"] = _verdict(code, out, err, result) or _silent(kind, file, originals, code) or "ok"
        return result


def _peak_bytes() -> int:
    """The most memory that this process has held; `getrusage` begins at that of the process that was copied."""
    lines = Path("/proc/self/status").read_text(encoding="utf-8").splitlines()
    return next(1024 * int(line.split()[1]) for line in lines if line.startswith("VmHWM"))


def _place(originals: Path, place: Path, kind: Kind) -> Path:
    """A copy of the file, and of the run folder that it lies in."""
    source, file = originals / kind.file, place / kind.file
    if file.parent != place:
        shutil.copytree(source.parent, file.parent)
    elif source.is_dir():
        shutil.copytree(source, file)
    else:
        shutil.copy(source, file)
    return file


def _call(words: list[str], place: Path) -> tuple[int, str, str]:
    """Exit code and both streams of a command, those of the libraries below Python too."""
    from cellpilot.cli.main import main

    streams = [place / ".out", place / ".err"]
    kept, before = [os.dup(1), os.dup(2)], Path.cwd()
    for number, stream in enumerate(streams, 1):
        os.dup2(os.open(stream, os.O_WRONLY | os.O_CREAT), number)
    os.chdir(place)
    try:
        code = main(words)
    except SystemExit as stop:
        code = stop.code if isinstance(stop.code, int) else 1
    except BaseException:
        code = -1
        os.write(2, traceback.format_exc().encode("utf-8", "replace"))
    finally:
        os.chdir(before)
        sys.stdout.flush()
        sys.stderr.flush()
        for number, descriptor in enumerate(kept, 1):
            os.dup2(descriptor, number)
            os.close(descriptor)
    out, err = (stream.read_text(encoding="utf-8", errors="replace") for stream in streams)
    return code, out, err


def _verdict(code: int, out: str, err: str, result: dict[str, Any]) -> str | None:
    """What is wrong with how a command ended."""
    lines = err.splitlines()
    if code not in (0, 1, 2) or "Traceback" in err:
        return "traceback"
    if code == 2 and (not lines or not lines[-1].startswith("cellpilot: ")):
        return "no line"
    noise = [line for line in lines if not line.startswith(EXPECTED)]
    if noise:
        return f"noise: {noise[0][:100]}"
    if any(ord(letter) < 32 and letter != "\n" for letter in out + err):
        return "control characters"
    if result["cpu_s"] > MOST_CPU_S:
        return "slow"
    return "memory" if result["peak_bytes"] > MOST_BYTES else None


def _silent(kind: Kind, file: Path, originals: Path, code: int) -> str | None:
    """Whether something else was read than what was written, without a word."""
    from cellpilot.errors import InputError

    if kind.content is None or code == 2:
        return None
    try:
        return "silently wrong" if kind.content(file) != kind.content(originals / kind.file) else None
    except InputError:
        return None  # made again by the command, or not read by it


def campaign(originals: Path, seed: int, first: int, inputs: int) -> Iterator[dict[str, Any]]:
    """The results of all inputs; a worker that dies or hangs costs the input that it was at, and another goes on."""
    done, end = first, first + inputs
    while done < end:
        command = [sys.executable, __file__, "--worker", str(originals), str(seed), str(done), str(end)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as worker:
            assert worker.stdout is not None
            watch = threading.Timer(PATIENCE_S, worker.kill)
            watch.start()
            for line in worker.stdout:
                watch.cancel()
                yield json.loads(line)
                done += 1
                watch = threading.Timer(PATIENCE_S, worker.kill)
                watch.start()
            watch.cancel()
        if done < end and worker.returncode not in (0, 3):
            name = list(KINDS)[done % len(KINDS)]
            yield {"number": done, "kind": name, "code": worker.returncode, "verdict": f"worker ended with {worker.returncode}"}
            done += 1


def _work(originals: Path, seed: int, first: int, end: int) -> int:
    """Attack one by one; leave after one that took much memory, because a peak never falls. Exit code 3: not all done."""
    for number in range(first, end):
        result = attack(originals, seed, number)
        sys.stdout.write(json.dumps(result) + "\n")
        sys.stdout.flush()
        if result["peak_bytes"] > MOST_BYTES / 2 and number + 1 < end:
            return 3
    return 0


def main() -> int:
    """Run a campaign and count how it ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--inputs", type=int, default=1000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first input")
    parser.add_argument("--folder", type=Path, required=True)
    parser.add_argument("--worker", nargs=4, help=argparse.SUPPRESS)
    if sys.argv[1:2] == ["--worker"]:
        place, seed, first, end = sys.argv[2:]
        return _work(Path(place), int(seed), int(first), int(end))
    options = parser.parse_args()
    originals = options.folder / "originals"
    if not originals.exists():
        make_originals(originals)
    verdicts: Counter[str] = Counter()
    codes: Counter[int] = Counter()
    slowest, largest = 0.0, 0
    with (options.folder / "results.jsonl").open("w", encoding="utf-8") as file:
        for result in campaign(originals, options.seed, options.first, options.inputs):
            file.write(json.dumps(result) + "\n")
            file.flush()
            verdicts[result["verdict"]] += 1
            codes[result["code"]] += 1
            slowest, largest = max(slowest, result.get("cpu_s", 0.0)), max(largest, result.get("peak_bytes", 0))
            if result["verdict"] != "ok":
                sys.stderr.write(f"{result['number']} {result['kind']}: {result['verdict']} {result.get('error', '')[-200:]}\n")
    sys.stdout.write(f"{sum(verdicts.values())} inputs: {dict(verdicts)}; exit codes {dict(codes)}; ")
    sys.stdout.write(f"slowest {slowest:.1f} CPU s, largest {largest / 1e9:.2f} GB\n")
    return int(set(verdicts) != {"ok"})


if __name__ == "__main__":
    sys.exit(main())
