"""What matters about a map, in words."""

from collections.abc import Iterator
from datetime import date

import numpy as np

from cellpilot.maps.account import ATTRIBUTE, account_of
from cellpilot.maps.schema import RadioMap, anchor_of


def described(radio_map: RadioMap, threshold_db: float, today: date | None = None) -> Iterator[str]:
    """Lines about the grid, where the numbers come from, and each height: share below the threshold, holes, uncertainty.

    The age of measurements counts to `today`, by default the day it is.
    """
    sides = " x ".join(str(radio_map.sizes[axis]) for axis in "xyz")
    steps = [float(np.diff(radio_map[axis].values[:2])[0]) for axis in "xy" if radio_map.sizes[axis] > 1]
    origin = f"source {radio_map.attrs.get('source') or 'unknown'}, {radio_map.attrs.get('model') or 'no model'}"
    yield f"{sides} cells of {' x '.join(f'{step:g}' for step in steps)} m, {origin}"
    anchor = anchor_of(radio_map)
    place = (
        "lies nowhere on Earth (no anchor)"
        if anchor is None
        else f"x = y = 0 at {anchor.latitude_deg:.6f}, {anchor.longitude_deg:.6f}"
    )
    yield place
    if "sector" in radio_map.dims:
        sectors = radio_map.sizes["sector"]
        stated = "sector_carrier_hz" in radio_map.coords
        carriers_mhz = np.unique(radio_map["sector_carrier_hz"].values / 1e6).tolist() if stated else []
        yield f"{sectors} sectors" + (f" on {', '.join(f'{mhz:g}' for mhz in carriers_mhz)} MHz" if carriers_mhz else "")
    for iz, z_m in enumerate(radio_map["z"].values):
        yield f"{z_m:g} m: {_level(radio_map, iz, threshold_db)}"
    if ATTRIBUTE in radio_map.attrs:
        account = account_of(radio_map)
        yield _age(account.days, today or date.today())
        yield from account.lines()


def _age(days: tuple[str, str] | None, today: date) -> str:
    if days is None:
        return "measured on days that the logs do not tell"
    first, last = days
    age = (today - date.fromisoformat(last)).days
    return f"measured {first}{'' if last == first else f' to {last}'}, {age} day{'' if age == 1 else 's'} ago"


def _level(radio_map: RadioMap, iz: int, threshold_db: float) -> str:
    values = {name: radio_map[name].values[iz] for name in ("sinr_db", "sinr_std_db", "count", "filled", "blocked")}
    free = ~values["blocked"]
    text = f"{free.sum()} free cells, {(~free).sum()} blocked"
    known = free & np.isfinite(values["sinr_db"])
    if not known.any():
        return f"{text}, nothing known"
    sinr_db = values["sinr_db"][known]
    low, middle, high = np.percentile(sinr_db, [10, 50, 90])
    text += f", {(sinr_db < threshold_db).mean():.1%} below {threshold_db:g} dB"
    text += f", median {middle:.1f} dB (10 to 90 %: {low:.1f} to {high:.1f} dB)"
    if values["filled"].any():
        text += f", {(values['filled'] & free).sum() / known.sum():.0%} of the known ones filled"
    if (free & ~known).any():
        text += f", {(free & ~known).sum()} unknown and counted as bad"
    std_db = values["sinr_std_db"][known]
    if std_db.any():
        text += f", uncertain by {np.sqrt(np.mean(std_db.astype(float) ** 2)):.1f} dB"
    if "sinr_spread_db" in radio_map and np.isfinite(radio_map["sinr_spread_db"].values[iz]).any():
        text += f", spread within a cell {np.nanmedian(radio_map['sinr_spread_db'].values[iz]):.1f} dB"
    return text
