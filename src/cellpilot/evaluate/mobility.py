"""What the network does while a drone flies: handovers after the A3 rule, ping-pong, outage in seconds.

Between the centres of two cells the RSRP of every sector runs straight in dB, so that the moment a neighbour has been
stronger by the hysteresis for the time to trigger follows without sampling. The SINR lost to a serving sector that is not
the best one counts like every other figure: in the cell that is entered. Handovers take no time and never fail; a drone
that enters a cell in which nothing is heard of its sector has lost the link, and begins anew on the strongest one.

Sources: event A3 and time to trigger, 3GPP TS 36.331 clauses 5.5.4.4 and 6.3.5; ping-pong, a return within the minimum
time of stay of 1 s, 3GPP TR 36.839 clause 5.6.
"""

from dataclasses import dataclass, field, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from cellpilot.array_types import FloatArray
from cellpilot.evaluate.statistics import weighted_quantile
from cellpilot.grid import IntArray
from cellpilot.settings import NonNegative, Positive, Settings
from cellpilot.signal import UNHEARD_DBM
from cellpilot.world import World

NEVER = np.inf
AHEAD_DB = 1e-9
"""Two sectors that cross are equally strong but for rounding: neither is ahead."""


class HandoverRule(Settings):
    """How fast the drone flies and when it changes its serving sector (event A3, 3GPP TS 36.331 clause 5.5.4.4)."""

    speed_mps: Positive = Field(10.0, description="planned speed, for outages in seconds and handovers [m/s]")
    hysteresis_db: NonNegative = Field(3.0, description="handover margin: how much stronger the neighbor must be [dB] (A3)")
    time_to_trigger_s: NonNegative = Field(
        0.256, description="time for which the neighbor must stay stronger before a handover (A3 time-to-trigger) [s]"
    )
    ping_pong_s: NonNegative = Field(
        1.0, description="a handover back within this time of the last one is a ping-pong [s] (TR 36.839 clause 5.6)"
    )


@dataclass(frozen=True)
class Mobility:
    """Sums over flights; `+` joins two sets of flights. Handovers count only where every sector is known."""

    followed_m: float = 0.0  # flown with the level of every sector known
    handovers: int = 0
    ping_pongs: int = 0
    links_lost: int = 0  # cells entered in which nothing is heard of the serving sector
    linked_steps: int = 0  # all others
    lost_db: float = 0.0  # sum over these of best-server SINR minus serving-sector SINR
    outages_s: FloatArray = field(default_factory=lambda: np.empty(0))  # [flights] longest time below the threshold

    def __add__(self, other: "Mobility") -> "Mobility":
        sums: dict[str, Any] = {f.name: getattr(self, f.name) + getattr(other, f.name) for f in fields(self)[:-1]}
        return Mobility(**sums, outages_s=np.concatenate([self.outages_s, other.outages_s]))

    @property
    def longest_outage_p90_s(self) -> float | None:
        """90th percentile over flights of the longest time below the threshold [s]; None without flights."""
        return weighted_quantile(self.outages_s, np.ones(self.outages_s.size), 0.9)


class Ride:
    """Follows some flights step by step; `mobility` has the sums so far."""

    def __init__(self, world: World, rule: HandoverRule, start: IntArray) -> None:
        n = len(start)
        self._world, self._rule = world, rule
        self._place_m = world.grid.metres(np.arange(world.grid.n_cells))  # [n_cells, 3]
        self._stay_m = min(np.diff(axis).min() for axis in (world.grid.x_m, world.grid.y_m, world.grid.z_m) if len(axis) > 1)
        self._outage_s, self._longest_s = np.zeros(n), np.zeros(n)
        self._sums = Mobility()
        if world.signal.levels is not None:
            self._serving, self._previous, self._since_handover_s = np.empty(n, np.intp), np.empty(n, np.intp), np.empty(n)
            self._held_s = np.empty((len(world.signal.levels.rsrp_dbm), n))  # how long each neighbour has been stronger
            self._connect(np.arange(n), world.signal.levels.rsrp_dbm[:, start])

    @property
    def mobility(self) -> Mobility:
        """What happened so far."""
        return replace(self._sums, outages_s=self._longest_s.copy())

    def step(self, flight: IntArray, cell: IntArray, next_cell: IntArray, low: NDArray[np.bool_]) -> None:
        """One step of the numbered flights `[n]`; `low`: the SINR measured in the cell entered is below the threshold.

        A step that ends where it began takes as long as one to the nearest cell.
        """
        length_m = np.linalg.norm(self._place_m[next_cell] - self._place_m[cell], axis=-1)
        time_s = np.where(length_m > 0, length_m, self._stay_m) / self._rule.speed_mps
        self._outage_s[flight] = np.where(low, self._outage_s[flight] + time_s, 0.0)
        self._longest_s[flight] = np.maximum(self._longest_s[flight], self._outage_s[flight])
        levels = self._world.signal.levels
        if levels is None:
            return
        here_dbm, here_db = levels.rsrp_dbm[:, next_cell], levels.sinr_db[:, next_cell]
        self._hand_over(flight, levels.rsrp_dbm[:, cell].astype(float), here_dbm.astype(float), time_s)
        serving = self._serving[flight]
        heard = here_dbm[serving, np.arange(len(flight))] > UNHEARD_DBM
        lost_db = here_db[:, heard].max(axis=0, initial=-np.inf) - here_db[serving, np.arange(len(flight))][heard]
        self._sums += Mobility(float(length_m.sum()), 0, 0, int((~heard).sum()), int(heard.sum()), float(lost_db.sum()))
        self._connect(flight[~heard], here_dbm[:, ~heard])

    def _connect(self, flight: IntArray, rsrp_dbm: NDArray[np.floating]) -> None:
        """A drone without a link begins anew on the strongest sector of `rsrp_dbm [sector, n]`."""
        self._serving[flight] = rsrp_dbm.argmax(axis=0)
        self._previous[flight] = -1
        self._since_handover_s[flight] = NEVER
        self._held_s[:, flight] = 0.0

    def _hand_over(self, flight: IntArray, begin_dbm: FloatArray, end_dbm: FloatArray, time_s: FloatArray) -> None:
        """All handovers of a step: RSRP `[sector, n]` runs straight from `begin_dbm` to `end_dbm` within `time_s [n]`."""
        now_s = np.zeros(len(flight))
        some = np.arange(len(flight))  # flights that may still hand over within this step
        while some.size:
            who = flight[some]
            serving = self._serving[who]
            begin, end, length_s, since_s = begin_dbm[:, some], end_dbm[:, some], time_s[some], now_s[some]
            column = np.arange(len(some))
            ahead_begin = begin - begin[serving, column] - self._rule.hysteresis_db
            ahead_end = end - end[serving, column] - self._rule.hysteresis_db
            ahead_now = ahead_begin + (ahead_end - ahead_begin) * since_s / length_s
            with np.errstate(divide="ignore", invalid="ignore"):
                crossing_s = length_s * ahead_begin / (ahead_begin - ahead_end)
            entered_s = np.where(ahead_now > AHEAD_DB, since_s - self._held_s[:, who], np.where(ahead_end > 0, crossing_s, NEVER))
            left_s = np.where(ahead_end > 0, length_s, np.where(ahead_now > AHEAD_DB, crossing_s, -NEVER))
            trigger_s = entered_s + self._rule.time_to_trigger_s
            trigger_s = np.where(trigger_s <= left_s, trigger_s, NEVER)
            first_s = trigger_s.min(axis=0)
            self._held_s[:, who] = np.where(ahead_end > 0, length_s - entered_s, 0.0)
            fires = np.isfinite(first_s)
            at_s = np.where(fires, first_s, 0.0)
            at_dbm = begin + (end - begin) * at_s / length_s
            target = np.where(trigger_s <= first_s, at_dbm, -NEVER).argmax(axis=0)
            some, who, at_s, target = some[fires], who[fires], at_s[fires], target[fires]
            stayed_s = self._since_handover_s[who] + at_s - since_s[fires]
            ping_pongs = (target == self._previous[who]) & (stayed_s < self._rule.ping_pong_s)
            self._sums += Mobility(handovers=len(who), ping_pongs=int(ping_pongs.sum()))
            self._previous[who], self._serving[who] = self._serving[who], target
            self._since_handover_s[who] = 0.0
            self._held_s[:, who] = 0.0
            now_s[some] = at_s
        self._since_handover_s[flight] += time_s - now_s
