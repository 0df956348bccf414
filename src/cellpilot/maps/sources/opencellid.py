"""Sites from an OpenCelliD (or Mozilla Location Service) export: where cells are, and nothing else about them.

Columns: radio, mcc, net, area, cell, unit, lon, lat, range, samples, changeable, created, updated, averageSignal; the files of
single countries come without a header line. Positions are estimated from where phones heard the cell, so a site is off by some
hundred metres. Heights, antennas, tilts, powers, carriers and bearings are not in it: all of them are ASSUMED.
"""

from collections import Counter
from dataclasses import dataclass
from math import isnan
from pathlib import Path

import numpy as np

from cellpilot.errors import InputError
from cellpilot.maps.geodesy import MAX_LATITUDE_DEG, Anchor, to_local
from cellpilot.maps.sources.sites import middle_of, unbroken
from cellpilot.maps.text_table import LONGITUDE_DEG, Column, open_table
from cellpilot.radio import ColumnAntenna, Deployment
from cellpilot.radio.ranges import check_range
from cellpilot.radio.settings import COLUMN, HEXAGONAL

OPENCELLID_COLUMNS = (
    "radio", "mcc", "net", "area", "cell", "unit", "lon", "lat", "range", "samples", "changeable", "created", "updated",
    "averageSignal",
)  # fmt: skip

CELLS_PER_ENODEB = 256
"""An LTE cell identity is the number of the base station (20 bits) and that of its cell (8 bits).

Source: 3GPP TS 36.413 clause 9.2.1.38.
"""


@dataclass(frozen=True)
class AssumedSectors:
    """What an OpenCelliD file does not say, the same for every site.

    `RangeError` for bearings outside 0..360 deg, `InputError` for none; the rest is checked as part of a `Deployment`.
    """

    azimuths_deg: tuple[float, ...] = (0.0, 120.0, 240.0)
    height_m: float = HEXAGONAL.base_height_m
    electrical_tilt_deg: float = COLUMN.electrical_tilt_deg
    power_dbm: float = 46.0
    carrier_hz: float = 1.8e9
    bandwidth_hz: float = HEXAGONAL.bandwidth_hz
    load: float = HEXAGONAL.load

    def __post_init__(self) -> None:
        if len(self.azimuths_deg) == 0:
            raise InputError("azimuths_deg is empty; expected at least one assumed bearing of a sector")
        check_range(self.azimuths_deg, "azimuths_deg", 0.0, 360.0, "deg")

    def words(self) -> str:
        """One line that says all of it."""
        bearings = ", ".join(f"{a:g}" for a in self.azimuths_deg)
        return (
            f"assumed for every site: sectors at {bearings} deg, {self.height_m:g} m,"
            f" column of {COLUMN.antenna_elements} elements at {self.electrical_tilt_deg:g} deg downtilt, {self.power_dbm:g} dBm,"
            f" {self.carrier_hz / 1e6:g} MHz, {self.bandwidth_hz / 1e6:g} MHz wide, load {self.load:g}"
        )


@dataclass(frozen=True, eq=False)
class AssumedSites:
    """A deployment at positions from OpenCelliD, with the account of what was read."""

    deployment: Deployment
    names: tuple[str, ...]
    anchor: Anchor
    account: tuple[str, ...]
    note: str = "assumed: everything but the position"
    """What every line of a site list made of it should say."""


def read_opencellid(
    path: str | Path,
    operator: str | None = None,
    assumed: AssumedSectors = AssumedSectors(),
    noise_figure_db: float = HEXAGONAL.noise_figure_db,
) -> AssumedSites:
    """LTE sites of one operator ("MCC-MNC") with assumed sectors; a site is where the cells of one base station are on average.

    Cells weigh by the number of their samples. `InputError` for a file without LTE cells, with several operators while none is
    chosen, and for broken lines.
    """
    path = Path(path)
    sites: dict[tuple[str, int], list[tuple[float, float, float]]] = {}
    dropped: Counter[str] = Counter()
    table, rows = open_table(path, "list of cells from OpenCelliD", OPENCELLID_COLUMNS)
    table.require(("radio", "mcc", "net", "cell", "lon", "lat"))
    for row in rows:
        if row.fields[0].strip().lower() == "radio":
            raise row.error(
                f"a header with other columns than an OpenCelliD export; expected {','.join(OPENCELLID_COLUMNS)}, or no header"
            )
        row.check_width()
        if row.text("radio").upper() != "LTE":
            dropped[f"of radio {row.text('radio') or 'unknown'}"] += 1
            continue
        name = f"{row.needed(Column('mcc', 1, 999)):.0f}-{row.needed(Column('net', 0, 999)):.0f}"
        base_station = int(row.needed(Column("cell", 0, 2**28 - 1))) // CELLS_PER_ENODEB
        samples = row.number(Column("samples", 0, 1e9))
        latitude_deg = row.needed(Column("lat", -MAX_LATITUDE_DEG, MAX_LATITUDE_DEG, "deg"))
        longitude_deg = row.needed(Column("lon", *LONGITUDE_DEG, "deg"))
        weight = 1.0 if isnan(samples) else max(samples, 1.0)
        sites.setdefault((name, base_station), []).append((latitude_deg, longitude_deg, weight))
    chosen = _operator(path, operator, Counter(name for name, _ in sites))
    mine = {number: np.array(cells) for (name, number), cells in sorted(sites.items()) if name == chosen}
    places = np.array([_site(*cells.T) for cells in mine.values()])
    anchor = middle_of(*places.T)
    account = (
        f"{path.name}: {sum(map(len, mine.values()))} LTE cells of operator {chosen} at {len(mine)} sites"
        + "".join(f", {count} cells {reason} left out" for reason, count in sorted(dropped.items())),
        assumed.words(),
    )
    x_m, y_m = to_local(places[:, 0], places[:, 1], anchor)
    n = len(assumed.azimuths_deg)
    deployment = Deployment(
        x_m=np.repeat(x_m, n),
        y_m=np.repeat(y_m, n),
        height_m=np.full(n * len(mine), assumed.height_m),
        boresight_deg=np.tile((90.0 - np.array(assumed.azimuths_deg)) % 360.0, len(mine)),
        power_dbm=np.full(n * len(mine), assumed.power_dbm),
        load=np.full(n * len(mine), assumed.load),
        antenna=(ColumnAntenna.of(COLUMN.changed(electrical_tilt_deg=assumed.electrical_tilt_deg)),) * (n * len(mine)),
        site=np.repeat(np.arange(len(mine)), n),
        carrier_hz=np.full(n * len(mine), assumed.carrier_hz),
        bandwidth_hz=np.full(n * len(mine), assumed.bandwidth_hz),
        noise_figure_db=noise_figure_db,
    )
    names = tuple(f"{number}/{sector}" for number in mine for sector in range(n))
    return AssumedSites(deployment, names, anchor, account)


def _site(latitude_deg: np.ndarray, longitude_deg: np.ndarray, samples: np.ndarray) -> tuple[float, float]:
    """Where the cells of a base station are on average."""
    return np.average(latitude_deg, weights=samples), np.average(unbroken(longitude_deg), weights=samples)


def _operator(path: Path, wanted: str | None, sites: Counter[str]) -> str:
    if not sites:
        raise InputError(f"{path}: no LTE cells; expected lines that begin with LTE")
    listed = ", ".join(f"{name} ({count} sites)" for name, count in sites.most_common(8))
    if wanted is None and len(sites) > 1:
        raise InputError(f"{path}: cells of {len(sites)} operators, {listed}; choose one: `operator` MCC-MNC")
    if wanted is not None and wanted not in sites:
        raise InputError(f"{path}: no cells of operator {wanted}; it has {listed}")
    return wanted or next(iter(sites))
