"""What matters about a map, in words."""

from collections.abc import Iterator
from datetime import date
from typing import NamedTuple

import numpy as np

from cellpilot.maps.account import ATTRIBUTE, account_of
from cellpilot.maps.estimate.correlation import CORRELATION_M
from cellpilot.maps.reasons import blocked_cells, counted_reasons, reasons_of
from cellpilot.maps.schema import RadioMap, anchor_of


class Below(NamedTuple):
    """Free cells of one height, how many of them count as below a threshold, and how many of those are unknown."""

    free: int
    below: int
    unknown: int

    @property
    def share(self) -> float:
        """Share of the free cells that count as below; 0 where there is none."""
        return self.below / max(self.free, 1)


def share_below(radio_map: RadioMap, iz: int, threshold_db: float) -> Below:
    """The free cells of one height against a threshold; as in a `World`, unknown ones count as below."""
    sinr_db = radio_map["sinr_db"].values[iz][~blocked_cells(radio_map)[iz]]
    unknown = int(np.isnan(sinr_db).sum())
    return Below(sinr_db.size, int((sinr_db < threshold_db).sum()) + unknown, unknown)


def described(radio_map: RadioMap, threshold_db: float, today: date | None = None) -> Iterator[str]:
    """Lines about the grid, its borders, where the numbers come from, and each height: share below the threshold, holes.

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
    yield _area(radio_map)
    if "sector" in radio_map.dims:
        sectors = radio_map.sizes["sector"]
        stated = "sector_carrier_hz" in radio_map.coords
        carriers_mhz = np.unique(radio_map["sector_carrier_hz"].values / 1e6).tolist() if stated else []
        yield f"{sectors} sectors" + (f" on {', '.join(f'{mhz:g}' for mhz in carriers_mhz)} MHz" if carriers_mhz else "")
    for iz, z_m in enumerate(radio_map["z"].values):
        yield f"{z_m:g} m: {_level(radio_map, iz, threshold_db)}"
    if radio_map.sizes["z"] > 1:
        heights = [share_below(radio_map, iz, threshold_db) for iz in range(radio_map.sizes["z"])]
        total = Below(*(sum(numbers) for numbers in zip(*heights, strict=True)))
        yield f"all heights: {total.free} free cells, {_share(total, threshold_db)}"
    yield from _changes(radio_map)
    if np.nan_to_num(radio_map["sinr_std_db"].values).any():
        yield f"error of the map: {_error(radio_map)}"
    if ATTRIBUTE in radio_map.attrs:
        account = account_of(radio_map)
        yield _age(account.days, today or date.today())
        yield from account.lines()


def _area(radio_map: RadioMap) -> str:
    """Borders of the area, and where cells are squares of whole millimetres the options that simulate on the same grid."""
    centres = {axis: radio_map[axis].values.astype(np.float64) for axis in "xy"}
    steps = {axis: float(np.ptp(values_m) / (values_m.size - 1)) for axis, values_m in centres.items() if values_m.size > 1}
    # A single row is as wide as the columns: cells are squares unless the map says otherwise.
    step_m = {axis: steps.get(axis, next(iter(steps.values()), 1.0)) for axis in "xy"}
    borders = {axis: [_metres(centres[axis][end] + side * step_m[axis] / 2) for end, side in ((0, -1), (-1, 1))] for axis in "xy"}
    text = "area " + ", ".join(f"{axis} {low} to {high} m" for axis, (low, high) in borders.items())
    whole = all(abs((float(high) - float(low)) / step_m["x"] % 1 - 0.5) > 0.5 - 1e-7 for low, high in borders.values())
    if abs(step_m["x"] - step_m["y"]) > 1e-3 or not whole or abs(float(_metres(step_m["x"])) - step_m["x"]) > 1e-9:
        return text
    options = [f"--map.{axis}-range-m {low} {high}" for axis, (low, high) in borders.items()]
    options.append(f"--map.bin-m {_metres(step_m['x'])}")
    anchor = anchor_of(radio_map)
    if anchor is not None:
        # In full: maps are compared cell by cell only where their anchors agree to a millimetre.
        options.append(f"--map.anchor {anchor.latitude_deg!r} {anchor.longitude_deg!r}")
    return f"{text}: {' '.join(options)}"


def _metres(value_m: float) -> str:
    """Metres to a millimetre, without needless zeros."""
    # Plus zero: a rounded -0 is 0.
    return f"{round(value_m, 3) + 0.0:.3f}".rstrip("0").rstrip(".")


def _changes(radio_map: RadioMap) -> Iterator[str]:
    """How holes were filled, and how a simulation was calibrated."""
    attributes = radio_map.attrs
    if "fill_method" in attributes and "fill_radius_m" in attributes:
        radius_m = float(attributes["fill_radius_m"])
        trend = f", departing from a simulation ({attributes['trend']})" if attributes.get("trend") else ""
        yield f"holes filled by {attributes['fill_method']} within {radius_m:g} m{trend}" if radius_m else "holes not filled"
    if "calibration_offset_db" in attributes:
        offset_db, factor, before_db, after_db = (
            float(attributes.get(f"calibration_{name}", np.nan))
            for name in ("offset_db", "spread_factor", "rmse_db_before", "rmse_db_after")
        )
        yield (
            f"calibrated by measurements: offset {offset_db:+.2f} dB, spread x {factor:.3f},"
            f" RMSE {before_db:.2f} dB before and {after_db:.2f} dB after"
        )


def _error(radio_map: RadioMap) -> str:
    """How what is unknown of the map hangs together."""
    common_db = float(radio_map.attrs.get("sinr_common_std_db", 0.0))
    over = f"correlated over {float(radio_map.attrs.get('sinr_correlation_m', CORRELATION_M)):g} m"
    if not common_db and "fill_kernel" in radio_map.attrs:
        return "drawn from the posterior of the Gaussian process"
    if "fill_posterior" in radio_map.attrs:
        over += f"; {radio_map.attrs['fill_posterior']}"
    return f"{common_db:.2f} dB common to all cells, the rest {over}" if common_db else over


def _age(days: tuple[str, str] | None, today: date) -> str:
    if days is None:
        return "measured on days that the logs do not tell"
    first, last = days
    age = (today - date.fromisoformat(last)).days
    return f"measured {first}{'' if last == first else f' to {last}'}, {age} day{'' if age == 1 else 's'} ago"


def _share(below: Below, threshold_db: float) -> str:
    unknown = f" ({below.unknown} unknown and counted as below)" if below.unknown else ""
    return f"{below.share:.1%} below {threshold_db:g} dB{unknown}"


def blocked_words(radio_map: RadioMap) -> str:
    """Number of blocked cells of a map, of how many, and for which reasons."""
    codes = radio_map["blocked_reason"].values
    return f"of {codes.size} cells {_blocked(codes, radio_map)}"


def _blocked(codes: np.ndarray, radio_map: RadioMap) -> str:
    why = counted_reasons(codes, reasons_of(radio_map))
    return f"{(codes > 0).sum()} blocked" + (f" ({why})" if why else "")


def _level(radio_map: RadioMap, iz: int, threshold_db: float) -> str:
    values = {name: radio_map[name].values[iz] for name in ("sinr_db", "sinr_std_db", "filled", "blocked_reason")}
    free = values["blocked_reason"] == 0
    text = f"{free.sum()} free cells, {_blocked(values['blocked_reason'], radio_map)}"
    share = share_below(radio_map, iz, threshold_db)
    if share.free:
        text += f", {_share(share, threshold_db)}"
    known = free & np.isfinite(values["sinr_db"])
    if not known.any():
        return f"{text}, nothing known"
    low, middle, high = np.percentile(values["sinr_db"][known], [10, 50, 90])
    text += f", median{' of the known' if share.unknown else ''} {middle:.1f} dB (10 to 90 %: {low:.1f} to {high:.1f} dB)"
    if values["filled"].any():
        text += f", {(values['filled'] & free).sum() / known.sum():.0%} of the known ones filled"
    std_db = values["sinr_std_db"][known]
    if std_db.any():
        text += f", uncertain by {np.sqrt(np.mean(std_db.astype(float) ** 2)):.1f} dB"
    if "sinr_spread_db" in radio_map and np.isfinite(radio_map["sinr_spread_db"].values[iz]).any():
        text += f", spread within a cell {np.nanmedian(radio_map['sinr_spread_db'].values[iz]):.1f} dB"
    return text
