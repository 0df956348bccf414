"""One file per algorithm, its settings beside it."""
