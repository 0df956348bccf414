"""Handovers against a plain clock that ticks every millisecond, and by hand on a corridor."""

from itertools import pairwise

import numpy as np
import pytest

from cellpilot.airspace import Airspace
from cellpilot.evaluate.metrics import METRICS
from cellpilot.evaluate.mobility import HandoverRule, Mobility, Ride
from cellpilot.evaluate.summary import Summary
from cellpilot.grid import Grid
from cellpilot.signal import SectorLevels, Signal
from cellpilot.world import World

RULE = HandoverRule(speed_mps=10.0, hysteresis_db=3.0, time_to_trigger_s=0.256, ping_pong_s=1.0)


def corridor(rsrp_dbm: np.ndarray, spacing_m: float = 20.0) -> World:
    """A row of cells with the RSRP `[sector, cell]`; the SINR of a sector is its RSRP plus 100."""
    n_cells = rsrp_dbm.shape[1]
    grid = Grid(tuple(spacing_m * i for i in range(n_cells)), (0.0,), (30.0,))
    zeros = np.zeros(n_cells, np.float32)
    levels = SectorLevels(rsrp_dbm.astype(np.float32), rsrp_dbm.astype(np.float32) + np.float32(100))
    return World(Airspace.of_blocked(grid, np.zeros(n_cells, bool)), Signal(zeros, levels=levels))


def ride_along(world: World, rule: HandoverRule, path: list[int], low: set[int] = frozenset()) -> Mobility:
    """The drone along the cells of a path."""
    ride = Ride(world, rule, np.array([path[0]]))
    for here, there in pairwise(path):
        ride.step(np.array([0]), np.array([here]), np.array([there]), np.array([there in low]))
    return ride.mobility


def plain_clock(world: World, rule: HandoverRule, path: list[int], tick_s: float = 1e-3) -> list[tuple[float, int]]:
    """(time, new sector) of every handover, with a timer for each neighbour, one tick after the other."""
    assert world.signal.levels is not None
    rsrp, x_m = world.signal.levels.rsrp_dbm.astype(float), np.array(world.grid.x_m)
    ends = np.concatenate([[0.0], np.cumsum(np.abs(np.diff(x_m[path])) / rule.speed_mps)])
    serving, since = int(rsrp[:, path[0]].argmax()), [None] * len(rsrp)
    handovers = []
    for now in np.arange(0.0, ends[-1], tick_s):
        level = [np.interp(now, ends, sector[path]) for sector in rsrp]
        for j, value in enumerate(level):
            since[j] = None if value <= level[serving] + rule.hysteresis_db else now if since[j] is None else since[j]
        ripe = [j for j, begin in enumerate(since) if begin is not None and now - begin >= rule.time_to_trigger_s - 1e-9]
        if ripe:
            serving, since = max(ripe, key=lambda j: level[j]), [None] * len(rsrp)
            handovers.append((now, serving))
    return handovers


def test_one_handover_at_the_moment_it_is_due() -> None:
    # Over 2 s sector 1 rises from 10 below to 10 above: 3 dB ahead after 1.3 s, handed over at 1.556 s, within the step.
    world = corridor(np.array([[-80.0, -90.0, -90.0], [-90.0, -80.0, -80.0]]))
    found = ride_along(world, RULE, [0, 1, 2])
    assert (found.handovers, found.ping_pongs, found.followed_m, found.linked_steps, found.links_lost) == (1, 0, 40.0, 2, 0)
    assert found.lost_db == 0.0
    # With a time to trigger of 0.8 s it comes in the second step: at cell 1 the old sector still serves, 10 dB below.
    late = ride_along(world, HandoverRule(time_to_trigger_s=0.8), [0, 1, 2])
    assert (late.handovers, late.lost_db) == (1, 10.0)
    assert ride_along(world, HandoverRule(time_to_trigger_s=3.0), [0, 1, 2]).handovers == 0
    assert ride_along(world, HandoverRule(hysteresis_db=10.0), [0, 1, 2]).handovers == 0


def test_a_dip_shorter_than_the_time_to_trigger_is_no_handover() -> None:
    # At 100 m/s a step takes 0.2 s: sector 1 is more than 3 dB ahead for less than 0.256 s around cell 1.
    world = corridor(np.array([[-80.0, -80.0, -80.0], [-90.0, -70.0, -90.0]]))
    assert ride_along(world, HandoverRule(speed_mps=100.0), [0, 1, 2]).handovers == 0
    assert ride_along(world, HandoverRule(speed_mps=20.0), [0, 1, 2]).handovers == 2


def test_back_within_a_second_is_a_ping_pong() -> None:
    world = corridor(np.array([[-80.0, -80.0, -80.0], [-90.0, -70.0, -90.0]]))
    fast, slow = (ride_along(world, HandoverRule(speed_mps=v), [0, 1, 2]) for v in (25.0, 10.0))
    assert (fast.handovers, fast.ping_pongs) == (2, 1)
    assert (slow.handovers, slow.ping_pongs) == (2, 0)


@pytest.mark.parametrize("seed", range(8))
def test_as_a_clock_that_ticks_every_millisecond(seed: int) -> None:
    rng = np.random.default_rng(seed)
    world = corridor(rng.normal(-85.0, 6.0, (5, 12)))
    path = [*range(12), *range(10, -1, -1)]
    rule = HandoverRule(speed_mps=float(rng.uniform(5, 60)), time_to_trigger_s=float(rng.uniform(0.05, 0.6)))
    expected = plain_clock(world, rule, path)
    found = ride_along(world, rule, path)
    assert found.handovers == len(expected) > 0
    back = [
        (now, sector)
        for (before, _), (now, sector), left in zip(expected, expected[1:], _left(world, path, expected), strict=False)
        if sector == left and now - before < rule.ping_pong_s
    ]
    assert found.ping_pongs == len(back)


def _left(world: World, path: list[int], handovers: list[tuple[float, int]]) -> list[int]:
    """The sector left at each handover."""
    assert world.signal.levels is not None
    return [int(world.signal.levels.rsrp_dbm[:, path[0]].argmax()), *(sector for _, sector in handovers)][:-1]


@pytest.mark.parametrize("seed", range(4))
def test_without_hysteresis_and_delay_the_strongest_serves(seed: int) -> None:
    world = corridor(np.random.default_rng(seed).normal(-85.0, 6.0, (5, 12)))
    found = ride_along(world, HandoverRule(hysteresis_db=0.0, time_to_trigger_s=0.0), [*range(12)])
    assert world.signal.levels is not None
    along = np.linspace(0.0, 11.0, 110_001)
    strongest = np.stack([np.interp(along, np.arange(12), sector) for sector in world.signal.levels.rsrp_dbm]).argmax(axis=0)
    assert found.handovers == (np.diff(strongest) != 0).sum() > 0
    assert found.lost_db == 0.0


def test_a_sector_that_is_heard_no_more_is_a_lost_link() -> None:
    # Sector 0 ends at cell 1; within the step the neighbour was not ahead for long enough.
    world = corridor(np.array([[-80.0, -156.0, -156.0, -80.0], [-90.0, -90.0, -90.0, -90.0]]))
    found = ride_along(world, HandoverRule(time_to_trigger_s=5.0), [0, 1, 2, 3])
    assert (found.links_lost, found.handovers, found.linked_steps) == (1, 0, 2)
    assert found.lost_db == 10.0  # in cell 3, where sector 0 is back and sector 1 still serves


def test_outages_in_seconds_and_flights_side_by_side() -> None:
    world = corridor(np.array([[-80.0] * 5, [-90.0] * 5]))
    alone = ride_along(world, RULE, [0, 1, 2, 3, 4], low={2, 3})
    assert alone.outages_s.tolist() == [4.0]
    stopped = ride_along(world, RULE, [0, 0, 1], low={0})  # a stopped step takes time but no way
    assert (stopped.outages_s.tolist(), stopped.followed_m) == ([2.0], 20.0)
    ride = Ride(world, RULE, np.array([0, 4]))
    ride.step(np.array([0, 1]), np.array([0, 4]), np.array([1, 3]), np.array([True, False]))
    ride.step(np.array([1]), np.array([3]), np.array([2]), np.array([True]))
    assert ride.mobility.outages_s.tolist() == [2.0, 2.0]
    both = alone + ride.mobility
    assert (both.followed_m, both.outages_s.tolist()) == (140.0, [4.0, 2.0, 2.0])


def test_metrics_of_mobility() -> None:
    def metric(name: str, mobility: Mobility) -> object:
        nothing = Summary(1.0, np.zeros((2, 2)), 1.0, 0.0, 0.0, np.ones(1), np.ones(3), np.ones(1), mobility)
        return METRICS[name].compute(nothing)

    flown = Mobility(1000.0, 6, 3, 2, 50, 25.0, np.arange(11.0))
    names = ("handovers_per_km", "ping_pong_share", "links_lost_per_km", "serving_loss_mean_db", "longest_outage_p90_s")
    assert [metric(name, flown) for name in names] == [6.0, 0.5, 2.0, 0.5, 9.0]
    assert [metric(name, Mobility()) for name in names] == [None] * 5


def test_a_step_that_stays_takes_as_long_as_one_to_the_nearest_cell() -> None:
    grid = Grid((0.0, 50.0, 100.0), (0.0, 40.0), (30.0, 60.0, 200.0))
    n = grid.n_cells
    world = World(Airspace.of_blocked(grid, np.zeros(n, bool)), Signal(np.zeros(n, np.float32)))
    for cell, next_cell, length_m in ((0, 0, 30.0), (0, 1, 50.0), (0, 3, 40.0), (0, 6, 30.0), (6, 12, 140.0), (12, 12, 30.0)):
        ride = Ride(world, HandoverRule(speed_mps=10.0), np.array([cell]))
        ride.step(np.array([0]), np.array([cell]), np.array([next_cell]), np.array([True]))
        assert ride.mobility.outages_s.tolist() == [pytest.approx(length_m / 10.0)]
