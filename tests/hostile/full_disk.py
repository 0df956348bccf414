"""Writing onto file systems of 16 kB to 1 MB (needs root and tmpfs): one line, exit code 2, nothing left, resumable.

sudo python tests/hostile/full_disk.py
"""

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from originals import make_originals

SIZES_KB = (16, 24, 32, 48, 64, 96, 128, 192, 256, 384, 512, 768, 1024)
PASSING = (".partial-", ".replaced-", ".in-use", ".tmp")
COMMAND = (sys.executable, "-c", "import sys; from cellpilot.cli.main import main; sys.exit(main())")


@contextmanager
def small_disk(place: Path, size_kb: int) -> Iterator[Path]:
    """A file system of that size."""
    place.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={size_kb}k", "none", str(place)], check=True)
    try:
        yield place
    finally:
        subprocess.run(["umount", str(place)], check=True)
        place.rmdir()


def call(words: str, where: Path) -> tuple[int, str]:
    """Exit code and standard error of a command."""
    ended = subprocess.run([*COMMAND, *words.split()], cwd=where, capture_output=True, text=True, timeout=600, check=False)
    return ended.returncode, ended.stderr


def faults_of(words: str, code: int, err: str, disk: Path) -> list[str]:
    """What is wrong with how a command ended."""
    lines = [line for line in err.splitlines() if line.startswith("cellpilot: ")]
    faults = leftovers(disk)
    if "Traceback" in err or code not in (0, 2) or (code == 2) != (len(lines) == 1):
        faults.append(f"exit code {code}: {err[-300:]}")
    if lines and "no space left" not in lines[0].lower():
        faults.append(f"says {lines[0]}")
    return [f"{words}: {fault}" for fault in faults]


def leftovers(disk: Path) -> list[str]:
    """Temporary files and locks that are still there."""
    return [f"left over: {path.relative_to(disk)}" for begin in PASSING for path in disk.rglob(f"{begin}*")]


def convert(originals: Path, disk: Path) -> tuple[list[str], str]:
    """`map convert` into all four formats."""
    faults, ends = [], []
    for ending in ("nc", "tif", "csv", "zarr"):
        code, err = call(f"map convert {originals}/m.nc {disk}/out.{ending}", disk)
        faults += faults_of(f"map convert .{ending}", code, err, disk)
        out = disk / f"out.{ending}"
        if (code == 2) == out.exists():
            faults.append(f"map convert .{ending}: exit code {code}, and the file is {'' if out.exists() else 'not '}there")
        ends.append(f".{ending} {code}")
        shutil.rmtree(out) if out.is_dir() else out.unlink(missing_ok=True)
    return faults, ", ".join(ends)


def evaluate(originals: Path, disk: Path) -> tuple[list[str], str]:
    """`evaluate` prints its numbers, whether or not there is room for `eval.nc`."""
    try:
        shutil.copytree(originals / "run", disk / "run", ignore=shutil.ignore_patterns("figures", "report.html", "eval.nc"))
    except shutil.Error:
        return [], "the run itself does not fit"
    ended = subprocess.run([*COMMAND, "evaluate", "run", "--json"], cwd=disk, capture_output=True, text=True, check=False)
    faults = leftovers(disk)
    if ended.returncode or '"policies"' not in ended.stdout or "Traceback" in ended.stderr:
        faults.append(f"evaluate: exit code {ended.returncode}: {ended.stderr[-300:]}")
    saved = (disk / "run" / "eval.nc").exists()
    if saved == ("not saved" in ended.stderr):
        faults.append(f"evaluate: says {ended.stderr[-200:]!r}")
    return faults, "saved" if saved else "printed, not saved"


def training(verb: str, originals: Path, disk: Path) -> tuple[list[str], str]:
    """`train` or `run`; where it failed on the way, it goes on once there is room."""
    code, err = call(f"{verb} {originals}/tiny.toml --out new", disk)
    faults = faults_of(verb, code, err, disk)
    if code == 0:
        return faults, "finished"
    run = disk / "new"
    if not run.exists():
        return faults, "nothing begun, nothing left"
    with tempfile.TemporaryDirectory() as roomy:
        shutil.copytree(run, Path(roomy) / "new")
        code, err = call(f"{verb} --resume new", Path(roomy))
        if code:
            faults.append(f"{verb} --resume: exit code {code}: {err[-300:]}")
        elif _policy(Path(roomy) / "new") != _policy(originals / "run"):
            faults.append(f"{verb} --resume: another policy than without the full disk")
    return faults, "stopped, and went on to the same policy elsewhere"


def _policy(run: Path) -> str:
    from cellpilot.policies import load_parameters
    from cellpilot.runs import policy_digest

    return policy_digest(load_parameters(run / "policy.safetensors"))


def main() -> int:
    """Try every command on every size."""
    failed = 0
    with tempfile.TemporaryDirectory() as folder:
        originals = Path(folder) / "originals"
        make_originals(originals)
        os.chdir(folder)
        attempts = {
            "map convert": convert,
            "evaluate": evaluate,
            "train": lambda *places: training("train", *places),
            "run": lambda *places: training("run", *places),
        }
        for size_kb in SIZES_KB:
            for name, attempt in attempts.items():
                with small_disk(Path(folder) / "disk", size_kb) as disk:
                    faults, end = attempt(originals, disk)
                sys.stdout.write(f"{size_kb:5} kB  {name}: {end}\n")
                for fault in faults:
                    sys.stdout.write(f"          WRONG {fault}\n")
                sys.stdout.flush()
                failed += bool(faults)
    sys.stdout.write(f"{failed} of {len(SIZES_KB) * len(attempts)} went wrong\n")
    return int(failed > 0)


if __name__ == "__main__":
    sys.exit(main())
