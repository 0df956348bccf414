"""A learner of the map: it flies, measures, keeps a posterior of SINR in every cell, and plans exactly on that.

The moves and the task are known, only the radio is not, so nothing else need be learned (the family of Dyna and
SNARM). What it is told: grid, blocked cells, task, and its own measurements, as noisy as they are. It never sees the
map, nor how strong the noise is: that is estimated with the rest. NumPy and SciPy only.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from cellpilot.airspace import Airspace
from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.evaluate.instances import sample_pairs
from cellpilot.grid import Grid, Position
from cellpilot.learn.algorithms.map_learner_settings import MapLearning
from cellpilot.learn.learner import Place
from cellpilot.maps.estimate.gaussian_process import GaussianProcess, Kernel, Measurements, combine, estimate_kernel
from cellpilot.policies.base import greedy_actions
from cellpilot.policies.optimal import OptimalPolicy
from cellpilot.signal import Signal, Unknown
from cellpilot.solve import optimal_values
from cellpilot.streams import Flying, stream
from cellpilot.task import Task, Transition
from cellpilot.world import World

DEFAULT_KERNEL = Kernel()
"""Before the first estimate, and the medians of its prior."""
POLICY = "map-learner"
"""Name of the policy in tables and figures."""


@dataclass(frozen=True)
class MeasuredFlight:
    """One flight of the learner."""

    transitions: Transition  # fields [steps]
    goal: int
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
        settings: MapLearning,
        seed: int,
        prior_mean_db: FloatArray | None = None,
        kernel: Kernel = DEFAULT_KERNEL,
    ) -> None:
        grid = airspace.grid
        self.airspace, self.grid, self.task, self.settings, self.seed = airspace, grid, task, settings, seed
        self.first_kernel = kernel
        self.prior_mean_db = without_holes(grid, prior_mean_db, task.threshold_db)
        pattern_db = self.prior_mean_db - self.prior_mean_db.mean()
        self._trends_db = settings.prior_slope_std * pattern_db[:, None]
        points_m = grid.metres(np.arange(grid.n_cells))
        self.posterior = GaussianProcess(kernel, points_m, self.prior_mean_db, self._trends_db)
        self.measured_cells: list[int] = []
        self.measured_db: list[float] = []
        self.n_flights = 0

    def fly(self, start: int, goal: int, measure: Callable[[int], float]) -> MeasuredFlight:
        """Fly from cell to cell, `measure` SINR [dB] in each that is entered, and learn from it."""
        rng = stream(self.seed, Flying.CHOICES, self.n_flights)
        here, pending, reached = start, 0, False
        steps: list[tuple[int, int, int, float, int]] = []
        actions = self.plan(goal, rng)
        for _ in range(self.task.max_steps):
            if pending == self._measurements_per_plan:
                self._learn(pending)
                pending, actions = 0, self.plan(goal, rng)
            action = int(actions[here])
            there, event = int(self.airspace.next_cell[here, action]), int(self.airspace.event[here, action])
            steps.append((here, action, there, measure(there), event))
            self.measured_cells.append(there)
            self.measured_db.append(steps[-1][3])
            here, pending = there, pending + 1
            reached, over = self.task.end(here, event, goal)
            if over:
                break
        self._learn(pending)
        self._land()
        return MeasuredFlight(Transition(*(np.array(column) for column in zip(*steps, strict=True))), goal, bool(reached))

    def take_in(self, cells: NDArray[np.int32], sinr_db: FloatArray) -> None:
        """Learn from a flight that another learner flew, in the portions in which it learned."""
        every = self._measurements_per_plan
        for i in range(0, len(cells), every):
            portion = slice(i, i + every)
            self.measured_cells += cells[portion].tolist()
            self.measured_db += sinr_db[portion].tolist()
            self._learn(len(cells[portion]))
        self._land()

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
        kernel = estimate_kernel(measurements, self.prior_mean_db[at], self.first_kernel, self._trends_db[at])
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

    @property
    def _measurements_per_plan(self) -> int:
        return self.settings.replan_every_steps or self.task.max_steps

    def _land(self) -> None:
        self.n_flights += 1
        if self.n_flights in self.settings.estimate_after_flights:
            self.estimate()

    def _learn(self, n_latest: int) -> None:
        self.posterior.update(self.measured_cells[-n_latest:], self.measured_db[-n_latest:])

    def _world(self, mean_db: FloatArray, std_db: FloatArray) -> World:
        unknown = Unknown.of(self.grid, std_db.astype(np.float32), self.posterior.kernel.length_m)
        return World(self.airspace, Signal(mean_db.astype(np.float32), self.posterior.kernel.noise_std_db, unknown))


def learn_map(
    world: World,
    task: Task,
    settings: MapLearning,
    seed: int,
    checkpoints: Sequence[int],
    prior_mean_db: FloatArray | None = None,
    kernel: Kernel = DEFAULT_KERNEL,
) -> Iterator[MapLearner]:
    """The learner after each number of flights of `checkpoints` (increasing) between random starts and goals in `world`.

    Start and goal, noise and draws of a flight are functions of seed and flight alone: every learner with this seed
    flies between the same places, however many flights follow. `InputError` for a world whose SINR is uncertain or
    unknown in free cells: there is no truth to measure.
    """
    if world.signal.unknown is not None or not np.isfinite(world.signal.mean_db[world.airspace.free_cells]).all():
        raise InputError(
            "the true map needs SINR in every free cell, and sinr_std_db 0:"
            " fill its unknown cells (`fill_radius_m`) or block them"
        )
    learner = MapLearner(world.airspace, task, settings, seed, prior_mean_db, kernel)
    for checkpoint in checkpoints:
        while learner.n_flights < checkpoint:
            fly_next(learner, Place(world, task))
        yield learner


def fly_next(learner: MapLearner, place: Place, error_db: FloatArray | None = None) -> MeasuredFlight:
    """The learner's next flight in the true world, whose map is off by `error_db [n_cells]`."""
    world, seed, flight = place.world, learner.seed, learner.n_flights
    start, goal = start_and_goal(world, seed, flight, place.start, place.goal)
    return learner.fly(start, goal, receiver(world, seed, flight, error_db))


def without_holes(grid: Grid, prior_mean_db: FloatArray | None, threshold_db: float) -> FloatArray:
    """The prior mean `[n_cells]`; a cell that it leaves open has the mean of its height, or the threshold."""
    if prior_mean_db is None:
        return np.full(grid.n_cells, float(threshold_db))
    by_height = np.array(prior_mean_db, dtype=np.float64).reshape(len(grid.z_m), -1)
    for level in by_height:
        known = np.isfinite(level)
        level[~known] = level[known].mean() if known.any() else threshold_db
    return by_height.ravel()


def start_and_goal(
    world: World, seed: int, flight: int, start: Position | None = None, goal: Position | None = None
) -> tuple[int, int]:
    """Cells between which a flight leads, drawn from all pairs that can reach each other unless one is given."""
    pair = sample_pairs(stream(seed, Flying.PAIR, flight), world, 1, start, goal)
    return int(pair.start[0]), int(pair.goal[0])


def receiver(world: World, seed: int, flight: int, error_db: FloatArray | None = None) -> Callable[[int], float]:
    """What measures SINR [dB] in a cell of the true world during one flight, noise included."""
    rng = stream(seed, Flying.NOISE, flight)
    error = lambda cell: None if error_db is None else error_db[cell]
    return lambda cell: float(world.signal.measure(cell, error(cell), noise=rng.standard_normal()))
