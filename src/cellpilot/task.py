"""`Task`: what a flight earns and when it ends. Every reward of equation 4.4 is a `Price` of an event.

`outcome` derives reward and end from the facts of a step, so that a hindsight goal is nothing but another goal;
`expected_outcome` is its expectation over noise and what is unknown of the map. Environment, replay, learners, optimum,
evaluation and exported policies all ask here. The arithmetic is what NumPy and traced arrays share.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple

import numpy as np

from cellpilot.airspace import ENTERED, MOVED, STOPPED
from cellpilot.errors import InputError
from cellpilot.grid import Grid
from cellpilot.world import World


class Transition(NamedTuple):
    """Facts of one step; every field has the same shape."""

    cell: Any  # int, before the step
    action: Any  # int
    next_cell: Any  # int, after the step
    sinr_db: Any  # float, as measured in `next_cell`, noise included
    event: Any  # int, what became of the move: see `cellpilot.airspace`


class Outcome(NamedTuple):
    """What a step brought."""

    reward: Any
    reached: Any  # the goal was entered
    terminated: Any  # the flight is over: the goal was entered, or a blocked cell


class Entering(NamedTuple):
    """What there is to be said of the cell that was entered."""

    cell: Any
    low: Any  # SINR below the threshold: 0 or 1, or the chance of it
    reached: Any  # the cell is the goal


class Move(NamedTuple):
    """What there is to be said of the move."""

    cell: Any  # before the move
    action: Any
    next_cell: Any
    event: Any


@dataclass(frozen=True)
class Price:
    """A reward for an event. `happens` returns 0 or 1, or for an uncertain event its chance, from `Entering` or from `Move`.

    `how_often`: every step, some steps, or once, with the step that ends the flight.
    """

    name: str
    reward: float
    of: Literal["entering", "move"]
    happens: Callable[[Any], Any]
    how_often: Literal["always", "sometimes", "at the end"] = "sometimes"


def _step(entering: Entering) -> Any:
    return 1.0


def _reached(entering: Entering) -> Any:
    return entering.reached


def _low(entering: Entering) -> Any:
    return entering.low


def _stopped(move: Move) -> Any:
    return move.event == STOPPED


def _entered(move: Move) -> Any:
    return move.event == ENTERED


@dataclass(frozen=True)
class Task:
    """Rewards (Table 4.2), SINR threshold, discount (Table 4.3) and the cap on steps of one flight."""

    rho_goal: float = 10.0
    rho_sinr: float = -1.0
    rho_step: float = -0.1
    rho_blocked: float = 0.0
    threshold_db: float = 3.0
    discount: float = 0.995
    max_steps: int = 400
    rho_end: float = -100.0
    more: tuple[Price, ...] = ()  # rewards of one's own

    def __post_init__(self) -> None:
        if not 0 < self.discount <= 1:
            raise InputError(f"discount is {self.discount:g}; expected 0 < discount <= 1")
        if self.max_steps < 1:
            raise InputError(f"max_steps is {self.max_steps}; expected at least 1")

    @property
    def prices(self) -> tuple[Price, ...]:
        """All rewards: the three of equation 4.4, those of forbidden moves, and one's own."""
        return (
            Price("rho_step", self.rho_step, "entering", _step, "always"),
            Price("rho_goal", self.rho_goal, "entering", _reached, "at the end"),
            Price("rho_sinr", self.rho_sinr, "entering", _low),
            Price("rho_blocked", self.rho_blocked, "move", _stopped),
            Price("rho_end", self.rho_end, "move", _entered, "at the end"),
            *self.more,
        )

    def entering_reward(self, cell: Any, low: Any, reached: Any) -> Any:
        """The part of a reward that the cell entered decides."""
        return self._sum("entering", Entering(cell, low, reached))

    def move_reward(self, cell: Any, action: Any, next_cell: Any, event: Any) -> Any:
        """The part of a reward that the move decides."""
        return self._sum("move", Move(cell, action, next_cell, event))

    def _sum(self, of: str, facts: Any) -> Any:
        total: Any = None
        for price in self.prices:
            if price.of == of and (price.reward or of == "entering"):  # of these the shape is that of the result
                part = price.reward * price.happens(facts)
                total = part if total is None else total + part
        return 0.0 if total is None else total

    def outcome(self, transition: Transition, goal: Any) -> Outcome:
        """What each transition brought, had it been flown towards `goal` (equation 4.4)."""
        cell, action, next_cell, sinr_db, event = transition
        return self._outcome(cell, action, next_cell, sinr_db < self.threshold_db, event, goal)

    def expected_outcome(self, moves: Any, cell: Any, action: Any, goal: Any, low_probability: Any = None) -> Outcome:
        """`outcome` in expectation over noise and what is unknown of the map.

        `moves` is a `World`, or an airspace together with the chance `low_probability [n_cells]` that a measurement is low.
        """
        if isinstance(moves, World):
            low_probability = moves.outage_probability(self.threshold_db) if low_probability is None else low_probability
            moves = moves.airspace
        next_cell = moves.next_cell[cell, action]
        return self._outcome(cell, action, next_cell, low_probability[next_cell], moves.event[cell, action], goal)

    def _outcome(self, cell: Any, action: Any, next_cell: Any, low: Any, event: Any, goal: Any) -> Outcome:
        reached, terminated = self.end(next_cell, event, goal)
        reward = self.entering_reward(next_cell, low, reached) + self.move_reward(cell, action, next_cell, event)
        return Outcome(reward, reached, terminated)

    def end(self, next_cell: Any, event: Any, goal: Any) -> tuple[Any, Any]:
        """Whether the goal was reached, and whether the flight is over."""
        reached = next_cell == goal
        return reached, reached | (event == ENTERED)

    def possible_prices(self, ends: bool) -> tuple[Price, ...]:
        """The prices that a flight can meet; `ends`: it may end in a blocked cell."""
        return tuple(price for price in self.prices if ends or price.name != "rho_end")

    def value_bounds(self, ends: bool = False) -> tuple[float, float]:
        """Least and greatest discounted return that any flight, however long, can have; infinite without discount.

        `ends`: the flight may end in a blocked cell.
        """
        rewards = lambda how_often: [p.reward for p in self.possible_prices(ends) if p.how_often == how_often]
        always, some, last = sum(rewards("always")), rewards("sometimes"), rewards("at the end")
        worst, best = min(0.0, always + sum(min(0.0, r) for r in some)), max(0.0, always + sum(max(0.0, r) for r in some))
        horizon = np.inf if self.discount == 1 else 1 / (1 - self.discount)
        least, greatest = worst * horizon if worst else 0.0, best * horizon if best else 0.0
        return least + min(0.0, *last), greatest + max(0.0, *last)

    def as_dict(self) -> dict[str, float]:
        """All numbers by name, for files; rewards of one's own are functions and are left out."""
        return {f.name: getattr(self, f.name) for f in fields(self) if f.name != "more"}

    @property
    def every_step_costs(self) -> bool:
        """Whether every step that does not end the flight costs something, so that circling never pays."""
        always = sum(p.reward for p in self.prices if p.how_often == "always")
        return always + sum(max(0.0, p.reward) for p in self.prices if p.how_often == "sometimes") < 0


def default_max_steps(grid: Grid) -> int:
    """Ten times the sum of the sides: 400 for 20 x 20, 450 for 20 x 20 x 5 (section 4.2.2)."""
    return 10 * sum(n for n in grid.sides if n > 1)


__all__ = ["MOVED", "Outcome", "Price", "Task", "Transition", "default_max_steps"]
