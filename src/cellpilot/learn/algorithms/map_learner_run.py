"""The map learner as a learner of a run: its checkpoint is what it measured, its policy the map as it believes it."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.map_learner import MapLearner, fly_next
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.learn.in_turn import FlightRow, InTurn
from cellpilot.learn.learner import Place
from cellpilot.policies import tables
from cellpilot.policies.learned import PolicyParameters
from cellpilot.streams import Flying, stream


class _OneSeed:
    """`learn.in_turn.OneSeed`: what is unknown of the map is drawn once, and flown in from the first flight to the last."""

    def __init__(self, settings: MapLearning, place: Place, seed: int) -> None:
        self.place, self.learner = place, MapLearner(place.world.airspace, place.task, settings, seed)
        unknown = place.world.signal.unknown
        normal = lambda: stream(seed, Flying.MAP).standard_normal(place.world.grid.n_cells)
        self.error_db = None if unknown is None else np.asarray(unknown.draw(normal()), np.float64)
        self.n_steps: list[int] = []

    def fly(self, number: int) -> FlightRow:
        """Flight `number`, which has to be the next one."""
        flight = fly_next(self.learner, self.place, self.error_db)
        total = self.place.task.outcome(flight.transitions, flight.goal).reward.sum()
        self.n_steps.append(flight.transitions.action.size)
        return FlightRow(float(total), self.n_steps[-1], flight.reached)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """All measurements in their order: they alone decide what is known."""
        n_flights = self.learner.settings.flights
        n = n_flights * self.place.task.max_steps
        padded = lambda values, length, dtype: np.pad(np.array(values, dtype), (0, length - len(values)))
        return {
            "cells": padded(self.learner.measured_cells, n, np.int32),
            "sinr_db": padded(self.learner.measured_db, n, np.float64),
            "n_steps": padded(self.n_steps, n_flights, np.int32),
        }

    def restore(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Learn from the same measurements again."""
        first = 0
        for n in arrays["n_steps"][arrays["n_steps"] > 0].tolist():
            portion = slice(first, first + n)
            self.learner.take_in(arrays["cells"][portion], arrays["sinr_db"][portion])
            self.n_steps.append(n)
            first += n

    def policy_parameters(self, about: dict[str, Any]) -> PolicyParameters:
        """The map as it is known, on which the policy plans where it flies."""
        posterior, airspace = self.learner.posterior, self.place.world.airspace
        tensors: dict[str, Any] = {"mean_db": posterior.mean_db.astype(np.float32), "std_db": posterior.std_db.astype(np.float32)}
        about = about | {"noise_std_db": posterior.kernel.noise_std_db, "discount": self.learner.settings.discount}
        return PolicyParameters(tensors | {"blocked": airspace.blocked}, tables.BELIEVED_MAP, airspace.grid.sides, about)


def map_learner_at(settings: MapLearning, place: Place) -> InTurn:
    """The map learner as a learner of a run; `InputError` where SINR is unknown in free cells: there is nothing to measure."""
    if not np.isfinite(place.world.signal.mean_db[place.world.airspace.free_cells]).all():
        raise InputError("map-learner needs SINR in every free cell: fill the map's unknown cells or block them")
    return InTurn(lambda seed: _OneSeed(settings, place, seed), lambda round_: settings.optimism * np.ones(np.shape(round_)))
