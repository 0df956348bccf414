"""What a learning curve says of some rounds. No JAX here."""

from collections.abc import Mapping

import numpy as np

FLIGHTS = "flights"
"""Column with the number of flights that ended in each round; a curve without it has one in each."""


def mean_of_flights(history: Mapping[str, np.ndarray], column: str, rounds: slice = slice(None)) -> float:
    """Mean of a column over all flights that ended in these rounds; NaN if none did."""
    values = np.asarray(history[column])[rounds]
    if FLIGHTS not in history or column not in ("episode_return", "n_steps", "reached"):
        return float(values.mean()) if values.size else float("nan")
    flights = np.asarray(history[FLIGHTS])[rounds].astype(np.float64)
    ended = flights > 0
    return float(np.average(values[ended].astype(np.float64), weights=flights[ended])) if ended.any() else float("nan")
