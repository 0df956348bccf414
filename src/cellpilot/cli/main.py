"""`cellpilot VERB ...`: finds the verb, turns every foreseen error into one line and exit code 2."""

import os
import sys
from importlib import import_module

VERBS = {
    "run": "map, train, evaluate and report in one",
    "map": "simulate, import, inspect and draw radio maps",
    "train": "train on a scenario, or go on with a run",
    "evaluate": "compare baseline, optimum and learned policy",
    "report": "figures and a self-contained page of a run",
    "plan": "a route between two places over a map or run",
    "export": "the trained policy as ONNX, for other programs",
    "adapt": "prepared on map A, deployed on an unknown network B: score against flights",
    "ablation": "the learner without double Q and without hindsight, over seeds (Figure 5.19)",
    "sensitivity": "reward parameters against signal and detour (section 4.2.2)",
    "doctor": "what is installed and whether it works",
}


def main(arguments: list[str] | None = None) -> int:
    """Run one verb and return the exit code: 0, 2 for bad input, 130 for an interrupt."""
    arguments = sys.argv[1:] if arguments is None else arguments
    verb = arguments[0] if arguments else "--help"
    if verb in ("-h", "--help"):
        sys.stdout.write(_usage())
        return 0
    if verb == "--version":
        from cellpilot import __version__

        sys.stdout.write(f"cellpilot {__version__}\n")
        return 0
    if verb not in VERBS:
        return _fail(f"unknown command {verb!r}; expected one of {', '.join(VERBS)}")
    from cellpilot.errors import InputError

    try:
        return int(import_module(f"cellpilot.cli.{verb}").main(arguments[1:]))
    except InputError as error:
        return _fail(str(error))
    except BrokenPipeError:
        # The reader of our output (head, less) has gone; there is nobody left to tell.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}")
    except KeyboardInterrupt:
        return _fail("interrupted", 130)


def _fail(message: str, code: int = 2) -> int:
    sys.stderr.write(f"cellpilot: {' '.join(message.split())}\n")
    return code


def _usage() -> str:
    lines = ["usage: cellpilot VERB ...      (cellpilot VERB --help for its options)", ""]
    lines += [f"  {verb:<12} {text}" for verb, text in VERBS.items()]
    return "\n".join(lines) + "\n"
