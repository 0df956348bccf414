"""Site lists: one line of a CSV file for each sector, as radio planners keep them.

| column | content |
|---|---|
| `site_id` | text; sectors with one id share a mast's shadowing and LOS state |
| `latitude`, `longitude` | WGS84 [deg]; or `x_m`, `y_m`, east and north [m] |
| `height_m` | antenna above ground [m, 1.5..300] |
| `sector_id` | text |
| `azimuth_deg` | boresight as a compass bearing [deg, 0..360]: 0 = north, 90 = east |
| `mechanical_tilt_deg` | optional, downwards [deg], default 0 |
| `electrical_tilt_deg` | downwards [deg]; optional with an antenna file, default the file's own |
| `antenna` | `column(ELEMENTS,SPACING_WAVELENGTHS)`, `column(..,..,FLOOR_DB)`, or an antenna file relative to the list |
| `power_dbm` | transmit power of the sector over its carrier [dBm] |
| `carrier_mhz`, `bandwidth_mhz` | carrier and channel bandwidth [MHz] |
| `load` | optional, share of the carrier in use [0..1], default 1 |

Further columns are allowed and left alone.
"""

import csv
import io
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import count
from math import isnan
from pathlib import Path
from typing import Any

import numpy as np

from cellpilot.errors import InputError
from cellpilot.maps.geodesy import MAX_LATITUDE_DEG, Anchor, farthest_from_the_rest, to_degrees, to_local
from cellpilot.maps.text_table import LONGITUDE_DEG, Column, Table, TextRow, for_spreadsheets, from_spreadsheets, open_table
from cellpilot.radio import Antenna, AntennaFile, ColumnAntenna, Deployment, PatternAntenna, read_antenna
from cellpilot.radio.antenna_file import antenna_text
from cellpilot.radio.interference import RESOURCE_BLOCKS
from cellpilot.radio.ranges import check_range
from cellpilot.radio.settings import COLUMN, HEXAGONAL
from cellpilot.storage import write_atomically

DEGREES, METRES = ("latitude", "longitude"), ("x_m", "y_m")
REQUIRED_COLUMNS = ("site_id", "height_m", "sector_id", "azimuth_deg", "antenna", "power_dbm", "carrier_mhz", "bandwidth_mhz")

NUMBER = r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:E[-+]?\d+)?)\s*"
COLUMN_ANTENNA = re.compile(rf"column\(\s*(\d{{1,4}})\s*,{NUMBER}(?:,{NUMBER})?\)", re.IGNORECASE)
FARTHEST_M = 2e7
"""Half way round the Earth: what lies farther east or north [m] is no place. Coordinates of UTM lie within."""
POWER_DBM = (-50.0, 100.0)
FARTHEST_SITE_KM = 200.0
"""A site farther from the middle of its list is taken for a mistake: exchanged coordinates, a lost sign."""


@dataclass(frozen=True, eq=False)
class SiteList:
    """A deployment with the names of its sectors, and where on Earth it stands."""

    deployment: Deployment
    names: tuple[str, ...] | None  # `site_id/sector_id` of each sector, see `sector_name`; None for a layout without names
    anchor: Anchor | None  # of x = y = 0; None for a list in metres without a given one
    in_degrees: bool = False  # whether the list itself says where on Earth its sites are


def read_sites(path: str | Path, anchor: Anchor | None = None, noise_figure_db: float = HEXAGONAL.noise_figure_db) -> SiteList:
    """The sectors of a site list.

    `anchor` is where x = y = 0 lies; by default the middle of the sites' extent. `InputError` with file, line and column for a
    missing column or value, a value out of range, an antenna that is none, a sector given twice, and a site far from the others.
    """
    path = Path(path)
    table, rows = open_table(path, "site list")
    in_degrees = _in_degrees(table)
    table.require(REQUIRED_COLUMNS)
    reader = _SectorReader(path.parent, in_degrees)
    sectors = [reader.sector(row) for row in rows]
    if not sectors:
        raise InputError(f"{path}: no sectors below the header; expected one line for each")
    arrays = {name: np.array([sector[name] for sector in sectors]) for name in sectors[0] if name not in ("antenna", "name")}
    if in_degrees:
        latitude_deg, longitude_deg = arrays.pop("latitude"), arrays.pop("longitude")
        _check_together(path, reader.lines, latitude_deg, longitude_deg)
        if anchor is None:
            anchor = middle_of(latitude_deg, longitude_deg)
        arrays["x_m"], arrays["y_m"] = to_local(latitude_deg, longitude_deg, anchor)
    antennas = tuple(sector["antenna"] for sector in sectors)
    deployment = Deployment(**arrays, antenna=antennas, noise_figure_db=noise_figure_db)
    return SiteList(deployment, tuple(sector["name"] for sector in sectors), anchor, in_degrees)


def sector_name(site_id: str, sector_id: str) -> str:
    """`site_id/sector_id`, with / in a `site_id` as %2F (and % as %25), so that different sectors have different names."""
    return f"{site_id.replace('%', '%25').replace('/', '%2F')}/{sector_id}"


def ids_of(name: str) -> tuple[str, str]:
    """`site_id` and `sector_id` behind a name: the inverse of `sector_name`."""
    site_id, _, sector_id = name.partition("/")
    return site_id.replace("%2F", "/").replace("%25", "%"), sector_id


def middle_of(latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> Anchor:
    """The middle of the places' extent."""
    places = (latitude_deg, unbroken(longitude_deg))
    latitude, longitude = (float((values.min() + values.max()) / 2) for values in places)
    return Anchor(latitude, longitude - 360 if longitude > 180 else longitude)


def unbroken(longitude_deg: np.ndarray) -> np.ndarray:
    """The longitudes, those in the west counted on beyond 180 degrees where the places lie on both sides of the antimeridian."""
    return np.where(longitude_deg < 0, longitude_deg + 360, longitude_deg) if np.ptp(longitude_deg) > 180 else longitude_deg


def write_sites(
    deployment: Deployment,
    path: str | Path,
    names: Sequence[str] | None = None,
    anchor: Anchor | None = None,
    note: str | None = None,
) -> None:
    """Write a deployment as a site list that `read_sites` reads back: in degrees with an anchor, else in metres.

    `names` are those of `sector_name`; by default of the numbers of site and sector. `note` goes into a further column, in
    every line. Antennas with measured cuts are written as files beside the list, each once, under names that are free; if
    anything cannot be written, nothing is.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder; expected a file to write the site list to, such as {path / 'sites.csv'}")
    check_range(deployment.power_dbm, "power", *POWER_DBM, "dBm")
    names = [f"{site}/{sector}" for sector, site in enumerate(deployment.site)] if names is None else names
    files = _AntennaFiles(path)
    lines: list[dict[str, Any]] = []
    for i in range(deployment.n_sectors):
        site_id, sector_id = ids_of(names[i])
        place = {"x_m": repr(float(deployment.x_m[i])), "y_m": repr(float(deployment.y_m[i]))}
        if anchor is not None:
            latitude, longitude = to_degrees(deployment.x_m[i], deployment.y_m[i], anchor)
            place = {"latitude": repr(float(latitude)), "longitude": repr(float(longitude))}
        lines.append(
            {"site_id": for_spreadsheets(site_id)}
            | place
            | {
                "height_m": repr(float(deployment.height_m[i])),
                "sector_id": for_spreadsheets(sector_id),
                "azimuth_deg": repr(float((90.0 - deployment.boresight_deg[i]) % 360.0)),
                **_antenna_fields(deployment.antenna[i], files),
                "power_dbm": repr(float(deployment.power_dbm[i])),
                "carrier_mhz": repr(float(deployment.carrier_hz[i] / 1e6)),
                "bandwidth_mhz": repr(float(deployment.bandwidth_hz[i] / 1e6)),
                "load": repr(float(deployment.load[i])),
            }
            | ({} if note is None else {"note": for_spreadsheets(note)})
        )

    table = io.StringIO()
    writer = csv.DictWriter(table, list(lines[0]), lineterminator="\n")
    writer.writeheader()
    writer.writerows(lines)
    try:
        files.write()
        write_atomically(path, table.getvalue())
    except BaseException:
        files.remove()
        raise


@dataclass
class _AntennaFiles:
    """The antenna files of a list that is being written."""

    list_path: Path
    names: dict[bytes, str] = field(default_factory=dict)  # of each pattern
    texts: dict[Path, str] = field(default_factory=dict)  # of the files that are not there yet
    made: list[Path] = field(default_factory=list)

    def name_of(self, antenna: PatternAntenna) -> str:
        """The file of this pattern. Antennas that differ in tilt alone share their cuts, and one file."""
        key = antenna.horizontal_db.tobytes() + antenna.vertical_db.tobytes() + repr(antenna.peak_gain_dbi).encode()
        if key not in self.names:
            # The tilt within the cuts counts as 0, so that the tilt in the list is what is added to them.
            header = {"NAME": antenna.name or "antenna", "ELECTRICAL_TILT": "0"}
            text = antenna_text(AntennaFile(header, antenna.peak_gain_dbi, None, 0.0, antenna.horizontal_db, antenna.vertical_db))
            self.names[key] = self._named(text)
        return self.names[key]

    def _named(self, text: str) -> str:
        """The first name that is free, or that of a file with this very text."""
        for number in count(1):
            file = self.list_path.with_name(f"{self.list_path.stem}-antenna-{number}.msi")
            if file not in self.texts and not os.path.lexists(file):
                self.texts[file] = text
                break
            if file.is_file() and file.read_bytes() == text.encode():
                break
        return file.name

    def write(self) -> None:
        """Write those that are not there yet."""
        for file, text in self.texts.items():
            write_atomically(file, text)
            self.made.append(file)

    def remove(self) -> None:
        """Take away what `write` made."""
        for file in self.made:
            file.unlink(missing_ok=True)


@dataclass
class _SectorReader:
    """Reads the lines of one site list."""

    folder: Path
    in_degrees: bool
    lines: list[int] = field(default_factory=list)
    sites: dict[str, int] = field(default_factory=dict)
    sectors: dict[tuple[str, str], int] = field(default_factory=dict)  # line of each
    antennas: dict[tuple[Any, ...], Antenna] = field(default_factory=dict)

    def sector(self, row: TextRow) -> dict[str, Any]:
        """Arguments of `Deployment` for this sector, its place and its name."""
        row.check_width()
        self.lines.append(row.line)
        site_id, sector_id = (_needed_text(row, name) for name in ("site_id", "sector_id"))
        first = self.sectors.setdefault((site_id, sector_id), row.line)
        if first != row.line:
            raise row.error(f"site_id {site_id!r} with sector_id {sector_id!r} is there already, in line {first}")
        place = {"x_m": (-FARTHEST_M, FARTHEST_M), "y_m": (-FARTHEST_M, FARTHEST_M)}
        if self.in_degrees:
            place = {"latitude": (-MAX_LATITUDE_DEG, MAX_LATITUDE_DEG), "longitude": LONGITUDE_DEG}
        load = row.number(Column("load", 0.0, 1.0))
        return {
            **{
                column: row.needed(Column(column, *limits, "m" if column.endswith("_m") else "deg"))
                for column, limits in place.items()
            },
            "height_m": row.needed(Column("height_m", 1.5, 300.0, "m")),
            "boresight_deg": (90.0 - row.needed(Column("azimuth_deg", 0.0, 360.0, "deg"))) % 360.0,
            "power_dbm": row.needed(Column("power_dbm", *POWER_DBM, "dBm")),
            "carrier_hz": 1e6 * row.needed(Column("carrier_mhz", 500.0, 100_000.0, "MHz")),
            "bandwidth_hz": _bandwidth_hz(row),
            "load": 1.0 if isnan(load) else load,
            "site": self.sites.setdefault(site_id, len(self.sites)),
            "antenna": self._antenna(row),
            "name": sector_name(site_id, sector_id),
        }

    def _antenna(self, row: TextRow) -> Antenna:
        text = _needed_text(row, "antenna")
        electrical_deg = row.number(Column("electrical_tilt_deg", -90.0, 90.0, "deg"))
        mechanical_deg = row.number(Column("mechanical_tilt_deg", -90.0, 90.0, "deg"))
        key = (text, repr(electrical_deg), repr(mechanical_deg))
        if key not in self.antennas:
            column = COLUMN_ANTENNA.fullmatch(text)
            # `os.path` says no to names that no file can have, where `Path` raises.
            if column is None and not os.path.isfile(self.folder / text):
                raise row.error(
                    f"antenna is {text!r}; expected column(ELEMENTS,SPACING,FLOOR_DB) or an antenna file,"
                    f" and there is no {self.folder / text}"
                )
            if column is not None and isnan(electrical_deg):
                raise row.error("electrical_tilt_deg is empty; expected the downtilt of the column [deg]")
            mechanical_deg = 0.0 if isnan(mechanical_deg) else mechanical_deg
            try:
                if column is None:
                    tilt_deg = None if isnan(electrical_deg) else electrical_deg
                    self.antennas[key] = read_antenna(self.folder / text).antenna(tilt_deg, mechanical_deg)
                else:
                    floor_db = float(column[3]) if column[3] else COLUMN.array_factor_floor_db
                    self.antennas[key] = ColumnAntenna(int(column[1]), float(column[2]), electrical_deg, mechanical_deg, floor_db)
            except InputError as error:
                raise row.error(f"antenna is {text!r}: {error}") from None
        return self.antennas[key]


def _in_degrees(table: Table) -> bool:
    given = [set(pair) & set(table.names) for pair in (DEGREES, METRES)]
    if bool(given[0]) == bool(given[1]):
        raise InputError(
            f"{table.path}, line {table.line}: {'both' if given[0] else 'neither'} latitude, longitude and x_m, y_m"
            " among its columns; expected one pair"
        )
    table.require(DEGREES if given[0] else METRES)
    return bool(given[0])


def _needed_text(row: TextRow, name: str) -> str:
    # An operator may call a site NA: what stands for no value elsewhere is a name here.
    text = from_spreadsheets(row.fields[row.table.names.index(name)].strip())
    if not text:
        raise row.error(f"{name} is empty; expected a name" if name != "antenna" else "antenna is empty; expected an antenna")
    return text


def _bandwidth_hz(row: TextRow) -> float:
    bandwidth_hz = 1e6 * row.needed(Column("bandwidth_mhz", 1.4, 20.0, "MHz"))
    if bandwidth_hz not in RESOURCE_BLOCKS:
        allowed = ", ".join(f"{hz / 1e6:g}" for hz in RESOURCE_BLOCKS)
        raise row.error(f"bandwidth_mhz is {row.text('bandwidth_mhz')}; expected one of {allowed}")
    return bandwidth_hz


def _check_together(path: Path, lines: list[int], latitude_deg: np.ndarray, longitude_deg: np.ndarray) -> None:
    row, distance_km = farthest_from_the_rest(latitude_deg, longitude_deg)
    if distance_km > FARTHEST_SITE_KM:
        raise InputError(
            f"{path}, line {lines[row]}: latitude {latitude_deg[row]:g}, longitude {longitude_deg[row]:g} lies"
            f" {distance_km:,.0f} km from the middle of the sites; expected at most {FARTHEST_SITE_KM:g} km: are they exchanged?"
        )


def _antenna_fields(antenna: Antenna, files: _AntennaFiles) -> dict[str, str]:
    if isinstance(antenna, ColumnAntenna):
        spacing, floor_db = float(antenna.spacing_wavelengths), float(antenna.array_factor_floor_db)
        text = f"column({antenna.n_vertical},{spacing!r},{floor_db!r})"
    elif isinstance(antenna, PatternAntenna):
        text = files.name_of(antenna)
    else:
        raise InputError(
            f"an antenna of type {type(antenna).__name__} cannot be written to a site list; expected a column or measured cuts"
        )
    return {
        "mechanical_tilt_deg": repr(float(antenna.mechanical_tilt_deg)),
        "electrical_tilt_deg": repr(float(antenna.electrical_tilt_deg)),
        "antenna": text,
    }
