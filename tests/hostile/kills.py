"""Kill -9 at moments spread over a training, resume, and compare with the uninterrupted one, bit by bit.

    python tests/hostile/kills.py --moments 40 --seed 0

For each learner: policy, learning curve, evaluation and map are those of the uninterrupted run, and nothing else is left.
"""

import argparse
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from originals import SCENARIO

# Checkpoints without a pause between them, so that many kills fall into a write.
PROGRAM = """
import sys
from cellpilot.cli.main import main
from cellpilot.learn import trainer
trainer.train_many.__wrapped__.__kwdefaults__.update(checkpoint_every_s=0.0)
sys.exit(main())
"""
LEARNERS = {
    "ddqn-her": "--learner.episodes 400 --learner.replay-start 200 --learner.updates-per-episode 10",
    "fqi-her": (
        "--learner.algorithm fqi-her --learner.rounds 60 --learner.flights 16 --learner.updates-per-round 40"
        " --learner.batch-size 128 --learner.hidden-units 16 --learner.goals-per-round 8"
    ),
}


def run(arguments: str, place: Path, kill_after_s: float | None = None) -> tuple[int, float]:
    """Exit code and seconds of `cellpilot ARGUMENTS`, killed after a while."""
    started = time.perf_counter()
    with subprocess.Popen(
        [sys.executable, "-c", PROGRAM, *arguments.split()], cwd=place, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
    ) as process:
        try:
            process.wait(kill_after_s)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            process.wait()
    return process.returncode, time.perf_counter() - started


def fingerprint(folder: Path) -> dict[str, object]:
    """What has to be equal: policy and map byte by byte, curve and evaluation by content, and the names of all files."""
    from cellpilot.runs import load_evaluation, map_digest
    from cellpilot.storage import load_netcdf

    facts = json.loads((folder / "run.json").read_text(encoding="utf-8"))
    evaluation = load_evaluation(folder)
    return {
        "policy": (folder / "policy.safetensors").read_bytes(),
        "map": (folder / "map.nc").read_bytes(),
        "curve": map_digest(load_netcdf(folder / "train.nc", "a curve")),
        "evaluation": (map_digest(evaluation), evaluation.attrs["metrics"]),
        "facts": (facts["updates"], facts["env_steps"]),
        "files": sorted(path.name for path in folder.iterdir()),
    }


def main() -> int:
    """Kill, resume, compare."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--moments", type=int, default=40)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng = np.random.default_rng(options.seed)
    unequal = 0
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        (place / "tiny.toml").write_text(SCENARIO, encoding="utf-8")
        for name, settings in LEARNERS.items():
            words = f"train tiny.toml {settings} --seed 3 --out"
            _, whole_s = run(f"{words} {name}", place)
            run(f"evaluate {name}", place)
            expected, equal, begun = fingerprint(place / name), 0, 0
            for number, moment_s in enumerate(np.sort(rng.uniform(0.15 * whole_s, whole_s, options.moments))):
                cut = f"{name}-{number}"
                run(f"{words} {cut}", place, float(moment_s))
                begun += (place / cut / "state.safetensors").exists()
                again = f"train --resume {cut}" if (place / cut / "scenario.toml").exists() else f"{words} {cut}"
                code, _ = run(again, place)
                run(f"evaluate {cut}", place)
                same = code == 0 and fingerprint(place / cut) == expected
                equal += same
                if not same:
                    sys.stdout.write(f"  {name}, killed after {moment_s:.2f} s: exit code {code}, not equal\n")
            sys.stdout.write(
                f"{name}: {equal} of {options.moments} kills between {0.15 * whole_s:.1f} and {whole_s:.1f} s resumed bit-equal"
                f" ({begun} with a checkpoint)\n"
            )
            sys.stdout.flush()
            unequal += options.moments - equal
    return int(unequal > 0)


if __name__ == "__main__":
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    sys.exit(main())
