"""`cellpilot train SCENARIO`: map and training, without evaluation and report."""

from collections.abc import Sequence
from contextlib import ExitStack

from cellpilot.cli.console import out
from cellpilot.cli.run import prepare_runs, train_with_bar, training_over_seeds


def main(arguments: Sequence[str]) -> int:
    """Verb `train`."""
    with ExitStack() as held:
        results = train_with_bar(prepare_runs(arguments, "train", "Make the map and train.", held))
    if results is not None and len(results) > 1:
        out.print(training_over_seeds(results))
    return 130 if results is None else 0
