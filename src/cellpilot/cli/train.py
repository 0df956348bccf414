"""`cellpilot train SCENARIO`: map and training, without evaluation and report."""

from collections.abc import Sequence

from cellpilot.cli.run import prepare, train_with_bar


def main(arguments: Sequence[str]) -> int:
    """Verb `train`."""
    run = prepare(arguments, "train", "Make the map and train.")
    return 0 if train_with_bar(run) else 130
