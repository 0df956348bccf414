"""`cellpilot VERB ...`: finds the verb, turns every foreseen error into one line and exit code 2."""

import os
import sys
from difflib import get_close_matches
from importlib import import_module

from cellpilot.text import as_flags, encodable, visible

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


def entry() -> int:
    """The program: `main` with streams that can be written to, and an exit code that counts what could not be."""
    _open_closed_streams()
    code = main()
    try:
        sys.stdout.flush()
    except BrokenPipeError:
        _discard(sys.stdout)
    except OSError as error:
        _discard(sys.stdout)
        return _fail(f"standard output: {error.strerror or error}") if code == 0 else code
    return code


def main(arguments: list[str] | None = None) -> int:
    """Run one verb and return the exit code: 0, 2 for bad input, 130 for an interrupt."""
    from cellpilot.errors import InputError

    arguments = sys.argv[1:] if arguments is None else arguments
    try:
        return _call(arguments[0] if arguments else "--help", arguments[1:])
    except InputError as error:
        return _fail(str(error))
    except BrokenPipeError:
        # The reader of our output (head, less) has gone; there is nobody left to tell.
        _discard(sys.stdout)
        return 0
    except OSError as error:
        # What we write to files names them; without a name it was a stream.
        return _fail(f"{error.filename or 'standard output'}: {error.strerror or error}")
    except MemoryError as error:
        return _fail(
            f"not enough memory ({str(error) or 'nothing more is known'}): use a smaller map or fewer of whatever there is"
        )
    except RecursionError:
        return _fail("something given is nested too deeply: simplify it")
    except KeyboardInterrupt:
        return _fail("interrupted", 130)


def _call(verb: str, arguments: list[str]) -> int:
    if verb in ("-h", "--help"):
        sys.stdout.write(_usage())
        return 0
    if verb == "--version":
        from cellpilot import __version__

        sys.stdout.write(f"cellpilot {__version__}\n")
        return 0
    if verb not in VERBS:
        near = get_close_matches(verb, VERBS, 1)
        hint = f"; perhaps you meant {near[0]}" if near else ""
        return _fail(f"unknown command {verb!r}; expected one of {', '.join(VERBS)}{hint}")
    return int(import_module(f"cellpilot.cli.{verb}").main(arguments))


def _fail(message: str, code: int = 2) -> int:
    text = f"cellpilot: {as_flags(visible(' '.join(message.split())))}\n"
    try:
        sys.stderr.write(encodable(text, getattr(sys.stderr, "encoding", None)))
        sys.stderr.flush()
    except OSError:
        _discard(sys.stderr)
    return code


def _open_closed_streams() -> None:
    """Streams that the caller has closed (`>&-`) swallow what is written to them: nobody wants to read it."""
    for name in ("stdin", "stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r" if name == "stdin" else "w", encoding="utf-8"))  # noqa: SIM115


def _discard(stream: object) -> None:
    """Let a stream that cannot be written lead nowhere, so that Python does not complain once more at its end."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())  # type: ignore[attr-defined]


def _usage() -> str:
    lines = ["usage: cellpilot VERB ...      (cellpilot VERB --help for its options)", ""]
    lines += [f"  {verb:<12} {text}" for verb, text in VERBS.items()]
    return "\n".join(lines) + "\n"
