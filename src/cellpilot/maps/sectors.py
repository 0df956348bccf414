"""The sectors of a map: what a deployment says of them, and what their received powers mean."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.maps.schema import RadioMap
from cellpilot.radio import Deployment, Interference

NOISE_FIGURE = "noise_figure_db"
"""Attribute of a map with the received power of every sector."""

NEEDED = ("sector_carrier_hz", "sector_bandwidth_hz", "sector_load")


def sectors_of(deployment: Deployment, names: Sequence[str] | None = None) -> dict[str, NDArray[np.generic]]:
    """Coordinates of the dimension `sector` of a map."""
    if names is None:
        names = [f"site {site}, {deg:g} deg" for site, deg in zip(deployment.site, deployment.boresight_deg, strict=True)]
    return {
        "sector_name": np.array(names),
        "sector_x_m": deployment.x_m,
        "sector_y_m": deployment.y_m,
        "sector_height_m": deployment.height_m,
        "sector_boresight_deg": deployment.boresight_deg,
        "sector_power_dbm": deployment.power_dbm,
        "sector_carrier_hz": deployment.carrier_hz,
        "sector_bandwidth_hz": deployment.bandwidth_hz,
        "sector_load": deployment.load,
    }


def sector_levels(radio_map: RadioMap) -> tuple[FloatArray, FloatArray] | None:
    """RSRP [dBm] and SINR [dB], had that sector served, `[sector, cell]` in the order of `Grid.cell`.

    Minus infinity of a sector that no ray reaches. None for a map without the received power of every sector, its carrier,
    bandwidth and load, and the noise figure.
    """
    if "rsrp_dbm" not in radio_map or NOISE_FIGURE not in radio_map.attrs or any(name not in radio_map.coords for name in NEEDED):
        return None
    rsrp_dbm = radio_map["rsrp_dbm"].values.reshape(radio_map.sizes["sector"], -1).astype(np.float64)
    rsrp_dbm = np.where(np.isnan(rsrp_dbm), -np.inf, rsrp_dbm)
    carrier_hz, bandwidth_hz, load = (radio_map[name].values for name in NEEDED)
    interference = Interference.of(carrier_hz, bandwidth_hz, load, float(radio_map.attrs[NOISE_FIGURE]))
    return rsrp_dbm, interference.sinr_of_each_db(rsrp_dbm + interference.subcarriers_db[:, None])
