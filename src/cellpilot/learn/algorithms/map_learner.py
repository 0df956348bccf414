"""A learner of the map: it flies, measures, keeps a posterior of SINR in every cell, and plans exactly on that.

The moves and the task are known, only the radio is not, so nothing else need be learned (the family of Dyna and
SNARM). What it is told: grid, blocked cells, task, and its own measurements, as noisy as they are. It never sees the
map, nor how strong the noise is: that is estimated with the rest. NumPy and SciPy only.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import Airspace
from cellpilot.errors import InputError
from cellpilot.evaluate.instances import sample_pairs
from cellpilot.grid import Grid
from cellpilot.maps.estimate.gaussian_process import GaussianProcess, Kernel, Measurements, combine, estimate_kernel
from cellpilot.policies.base import greedy_actions
from cellpilot.policies.optimal import OptimalPolicy
from cellpilot.signal import Signal, Unknown
from cellpilot.solve import optimal_values
from cellpilot.task import Task
from cellpilot.world import World

FloatArray = NDArray[np.float64]
Exploration = Literal["optimism", "thompson"]
EXPLORATIONS = ("optimism", "thompson")
POLICY = "map-learner"
"""Name of the policy in tables and figures."""


@dataclass(frozen=True)
class MapLearnerSettings:
    """How the map is explored, estimated and planned on."""

    exploration: Exploration = "optimism"
    optimism: float = 1.0  # standard deviations added to the mean while exploring
    replan_every_steps: int = 1  # measurements between two plans of one flight; 0 = one plan per flight
    estimate_after_flights: tuple[int, ...] = (3, 5, 10, 20, 40, 80)  # when the hyper-parameters are estimated anew
    kernel: Kernel = field(default_factory=Kernel)  # before the first estimate, and the medians of its prior
    prior_slope_std: float = 0.5  # how far from 1 the true multiple of a prior map's pattern may be
    discount: float = 1.0  # of the plans; 1 = the undiscounted return, by which every policy is scored

    def __post_init__(self) -> None:
        if self.exploration not in EXPLORATIONS:
            raise InputError(f"exploration is {self.exploration!r}; expected one of {', '.join(EXPLORATIONS)}")
        if not np.isfinite(self.optimism) or self.optimism < 0:
            raise InputError(f"optimism is {self.optimism:g}; expected 0 or more standard deviations")
        if self.replan_every_steps < 0:
            raise InputError(f"replan_every_steps is {self.replan_every_steps}; expected 0 (one plan per flight) or more")
        if not np.isfinite(self.prior_slope_std) or self.prior_slope_std < 0:
            raise InputError(f"prior_slope_std is {self.prior_slope_std:g}; expected 0 or more")
        if not 0 < self.discount <= 1:
            raise InputError(f"discount is {self.discount:g}; expected 0 < discount <= 1")


@dataclass(frozen=True)
class Flight:
    """One flight of the learner."""

    cells: NDArray[np.int32]  # [steps] cells entered
    sinr_db: FloatArray  # [steps] as measured there
    reached: bool


class MapLearner:
    """What is known of one place, growing flight by flight.

    `prior_mean_db [n_cells]` is a map of the same grid that may be wrong, such as a simulation; without one the prior
    mean is the threshold. An unknown constant, one of each height, and an unknown multiple of the prior's pattern (its
    deviations from its mean) are added and estimated: a prior may be off in level, and too strong or too weak.
    """

    def __init__(
        self,
        airspace: Airspace,
        task: Task,
        settings: MapLearnerSettings,
        seed: int,
        prior_mean_db: FloatArray | None = None,
    ) -> None:
        grid = airspace.grid
        self.airspace, self.grid, self.task, self.settings, self.seed = airspace, grid, task, settings, seed
        self.prior_mean_db = without_holes(grid, prior_mean_db, task.threshold_db)
        pattern_db = self.prior_mean_db - self.prior_mean_db.mean()
        self._trends_db = settings.prior_slope_std * pattern_db[:, None]
        points_m = grid.metres(np.arange(grid.n_cells))
        self.posterior = GaussianProcess(settings.kernel, points_m, self.prior_mean_db, self._trends_db)
        self.measured_cells: list[int] = []
        self.measured_db: list[float] = []
        self.n_flights = 0

    def fly(self, start: int, goal: int, measure: Callable[[int], float]) -> Flight:
        """Fly from cell to cell, `measure` SINR [dB] in each that is entered, and learn from it."""
        rng = np.random.default_rng([self.seed, 3, self.n_flights])
        first, here, pending, reached = len(self.measured_cells), start, 0, False
        every = self.settings.replan_every_steps or self.task.max_steps
        actions = self.plan(goal, rng)
        for _ in range(self.task.max_steps):
            if pending == every:
                self._learn(pending)
                pending, actions = 0, self.plan(goal, rng)
            action = actions[here]
            here, event = int(self.airspace.next_cell[here, action]), self.airspace.event[here, action]
            self.measured_cells.append(here)
            self.measured_db.append(measure(here))
            pending += 1
            reached, over = self.task.end(here, event, goal)
            if over:
                break
        self._learn(pending)
        self.n_flights += 1
        if self.n_flights in self.settings.estimate_after_flights:
            self.estimate()
        return Flight(np.array(self.measured_cells[first:], np.int32), np.array(self.measured_db[first:]), bool(reached))

    def plan(self, goal: int, rng: np.random.Generator) -> NDArray[np.int8]:
        """Exploring actions `[n_cells]` towards one goal: the exact plan on an optimistic map, or on a drawn one."""
        if self.settings.exploration == "thompson":
            guess_db = self.posterior.sample(rng)
        else:
            guess_db = self.posterior.mean_db + self.settings.optimism * self.posterior.std_db
        values = optimal_values(
            self._world(guess_db, np.zeros(self.grid.n_cells)), self.task, np.array([goal]), self.settings.discount
        )
        return greedy_actions(np.nan_to_num(values[:, 0], neginf=-1e18))

    def estimate(self) -> None:
        """Estimate the hyper-parameters from all measurements, and with them the posterior anew."""
        cells, values_db = np.array(self.measured_cells), np.array(self.measured_db)
        count, mean_db, squares_db2 = combine(cells, values_db, self.grid.n_cells)
        at = np.flatnonzero(count)
        measurements = Measurements(self.posterior.points_m[at], count[at], mean_db[at], squares_db2[at])
        kernel = estimate_kernel(measurements, self.prior_mean_db[at], self.settings.kernel, self._trends_db[at])
        self.posterior = GaussianProcess(kernel, self.posterior.points_m, self.prior_mean_db, self._trends_db)
        self.posterior.update_means(count, mean_db)

    def believed_world(self) -> World:
        """The world as it is known now: mean and uncertainty of every cell, and the noise of a measurement."""
        return self._world(self.posterior.mean_db, self.posterior.std_db)

    def policy(self) -> OptimalPolicy:
        """The plan of highest expected return on what is known now, for every goal.

        Expected rewards are linear in the chance of low SINR in each cell, so that chance, Phi((threshold - mean) /
        sqrt(std^2 + noise^2)), is all that such a plan needs of the posterior.
        """
        return OptimalPolicy(self.believed_world(), self.task, self.settings.discount, POLICY)

    def _learn(self, n_latest: int) -> None:
        self.posterior.update(self.measured_cells[-n_latest:], self.measured_db[-n_latest:])

    def _world(self, mean_db: FloatArray, std_db: FloatArray) -> World:
        unknown = Unknown.of(self.grid, std_db.astype(np.float32), self.posterior.kernel.length_m)
        return World(self.airspace, Signal(mean_db.astype(np.float32), self.posterior.kernel.noise_std_db, unknown))


def learn_map(
    world: World,
    task: Task,
    settings: MapLearnerSettings,
    seed: int,
    checkpoints: Sequence[int],
    prior_mean_db: FloatArray | None = None,
) -> Iterator[MapLearner]:
    """The learner after each number of flights of `checkpoints` (increasing) between random starts and goals in `world`.

    Start and goal, noise and draws of a flight are functions of seed and flight alone: every learner with this seed
    flies between the same places, however many flights follow. `InputError` for a world whose SINR is uncertain or
    unknown in free cells: there is no truth to measure.
    """
    if world.signal.unknown is not None or not np.isfinite(world.signal.mean_db[world.airspace.free_cells]).all():
        raise InputError(
            "the true map needs SINR in every free cell, and sinr_std_db 0:"
            " fill its unknown cells (--fill-radius-m) or block them"
        )
    learner = MapLearner(world.airspace, task, settings, seed, prior_mean_db)
    for checkpoint in checkpoints:
        while learner.n_flights < checkpoint:
            flight = learner.n_flights
            start, goal = start_and_goal(world, seed, flight)
            learner.fly(start, goal, receiver(world, seed, flight))
        yield learner


def without_holes(grid: Grid, prior_mean_db: FloatArray | None, threshold_db: float) -> FloatArray:
    """The prior mean `[n_cells]`; a cell that it leaves open has the mean of its height, or the threshold."""
    if prior_mean_db is None:
        return np.full(grid.n_cells, float(threshold_db))
    by_height = np.array(prior_mean_db, dtype=np.float64).reshape(len(grid.z_m), -1)
    for level in by_height:
        known = np.isfinite(level)
        level[~known] = level[known].mean() if known.any() else threshold_db
    return by_height.ravel()


def start_and_goal(world: World, seed: int, flight: int) -> tuple[int, int]:
    """Cells between which a flight leads, drawn from all pairs that can reach each other."""
    pair = sample_pairs(np.random.default_rng([seed, 1, flight]), world, 1)
    return int(pair.start[0]), int(pair.goal[0])


def receiver(world: World, seed: int, flight: int) -> Callable[[int], float]:
    """What measures SINR [dB] in a cell of the true world during one flight, noise included."""
    rng = np.random.default_rng([seed, 2, flight])
    return lambda cell: float(world.signal.measure(cell, noise=rng.standard_normal()))
