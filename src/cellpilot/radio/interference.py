"""Who disturbs whom: from the power of every sector to the serving one and the SINR."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from cellpilot.array_types import IndexArray
from cellpilot.errors import InputError
from cellpilot.radio.ranges import FloatArray, as_floats
from cellpilot.units import THERMAL_NOISE_DBM_HZ, from_db, to_db

RESOURCE_BLOCKS = {1.4e6: 6, 3e6: 15, 5e6: 25, 10e6: 50, 15e6: 75, 20e6: 100}
"""Resource blocks of each LTE channel bandwidth [Hz]: 3GPP TS 36.104 Table 5.6-1."""

SUBCARRIERS_PER_BLOCK = 12
SUBCARRIER_SPACING_HZ = 15e3


@dataclass(frozen=True, eq=False)
class Interference:
    """What sectors share: every array is `[sector]`, but for the share of channels in one another."""

    load: FloatArray  # share of the carrier in use, 0..1
    noise_dbm: FloatArray  # receiver noise over the bandwidth
    n_subcarriers: NDArray[np.int64]  # occupied
    channel: IndexArray  # equal carrier and bandwidth
    share: FloatArray  # [channel i, channel j] share of j's power that falls into i's band

    @classmethod
    def of(cls, carrier_hz: FloatArray, bandwidth_hz: FloatArray, load: FloatArray, noise_figure_db: float) -> "Interference":
        """Of sectors `[sector]` on these carriers; `InputError` for a bandwidth LTE does not have.

        Bands overlap as far as their occupied subcarriers do. Noise is thermal noise at 290 K over the channel bandwidth
        plus the noise figure of the receiver.
        """
        blocks = np.array([RESOURCE_BLOCKS[hz] for hz in check_bandwidths(bandwidth_hz).tolist()])
        bands, first, channel = np.unique(
            np.stack([carrier_hz, bandwidth_hz], axis=-1), axis=0, return_index=True, return_inverse=True
        )
        occupied_hz = SUBCARRIER_SPACING_HZ * SUBCARRIERS_PER_BLOCK * blocks[first]
        low_hz, high_hz = bands[:, 0] - occupied_hz / 2, bands[:, 0] + occupied_hz / 2
        overlap_hz = np.minimum(high_hz[:, None], high_hz) - np.maximum(low_hz[:, None], low_hz)
        return cls(
            load=load,
            noise_dbm=np.asarray(THERMAL_NOISE_DBM_HZ + 10.0 * np.log10(bandwidth_hz) + noise_figure_db),
            n_subcarriers=SUBCARRIERS_PER_BLOCK * blocks,
            channel=channel.reshape(-1),
            share=np.clip(overlap_hz, 0.0, None) / occupied_hz,
        )

    @property
    def subcarriers_db(self) -> FloatArray:
        """Power of the whole carrier over that of one subcarrier [dB]: 3GPP TS 36.214 clause 5.1.1, spread evenly."""
        return np.asarray(10.0 * np.log10(self.n_subcarriers))

    def serve(self, sector_dbm: FloatArray) -> tuple[IndexArray, FloatArray, FloatArray]:
        """Sector of the strongest RSRP, its power [dBm] and its SINR [dB] `[point]`, from the power `[sector, point]` [dBm]."""
        per_subcarrier_db = self.subcarriers_db[:, None]
        several = np.ptp(per_subcarrier_db) > 0
        serving = (sector_dbm - per_subcarrier_db if several else sector_dbm).argmax(axis=0)[None]
        power_dbm = np.take_along_axis(sector_dbm, serving, axis=0)[0]
        interference_mw = self.load[:, None] * from_db(sector_dbm)
        # Zeroing the serving sector instead of subtracting it from the total: interferers may lie 75 dB below it.
        np.put_along_axis(interference_mw, serving, 0.0, axis=0)
        by_channel_mw = self._by_channel(interference_mw)
        several_channels = len(by_channel_mw) > 1
        sum_mw = (self.share[self.channel[serving[0]]].T * by_channel_mw).sum(axis=0) if several_channels else by_channel_mw[0]
        return serving[0], power_dbm, power_dbm - to_db(sum_mw + from_db(self.noise_dbm)[serving[0]])

    def sinr_of_each_db(self, sector_dbm: FloatArray) -> FloatArray:
        """SINR `[sector, point]` [dB] if that sector served, from the power `[sector, point]` [dBm]."""
        sent_mw = self.load[:, None] * from_db(sector_dbm)
        by_channel_mw = self._by_channel(sent_mw)
        sinr_db = np.empty_like(sector_dbm)
        for sector, channel in enumerate(self.channel):
            heard_mw = by_channel_mw.copy()
            heard_mw[channel] -= sent_mw[sector]
            # Where it outweighs the rest of its channel, the rest is summed anew: it may lie 75 dB below.
            outweighs = np.flatnonzero(2.0 * sent_mw[sector] > by_channel_mw[channel])
            others = (self.channel == channel) & (np.arange(len(self.channel)) != sector)
            heard_mw[channel, outweighs] = sent_mw[np.ix_(others, outweighs)].sum(axis=0)
            interference_mw = self.share[channel] @ heard_mw
            sinr_db[sector] = sector_dbm[sector] - to_db(interference_mw + from_db(self.noise_dbm[sector]))
        return sinr_db

    def _by_channel(self, power_mw: FloatArray) -> FloatArray:
        return np.stack([power_mw[self.channel == number].sum(axis=0) for number in range(len(self.share))])


def check_bandwidths(bandwidth_hz: ArrayLike) -> FloatArray:
    """The same as an array; `InputError` for a bandwidth that LTE does not have."""
    checked = as_floats(bandwidth_hz, "bandwidth")
    wrong = [hz for hz in checked.ravel().tolist() if hz not in RESOURCE_BLOCKS]
    if wrong:
        allowed = ", ".join(f"{hz / 1e6:g}" for hz in RESOURCE_BLOCKS)
        raise InputError(f"bandwidth is {wrong[0] / 1e6:g} MHz; expected one of {allowed} MHz")
    return checked
