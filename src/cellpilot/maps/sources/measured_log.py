"""Measured logs: the sparse CSV export of a drive-test tool, one file per flight height.

Most columns of a line are empty. A line carries either `RS SNR` [dB] (interference included, so it is the SINR) or
`RSRP (LTE pcell)` [dBm], at `Latitude`, `Longitude` (WGS84). There is no altitude column. The last lines are a note
of the export: a marker and the path of a file.
"""

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from math import isfinite
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from cellpilot.errors import InputError
from cellpilot.maps.account import ATTRIBUTE, ImportAccount, LevelAccount, LogAccount
from cellpilot.maps.estimate.neighbours import fill
from cellpilot.maps.geodesy import Anchor, to_local
from cellpilot.maps.gridding import Bins, grid_samples
from cellpilot.maps.hover import Mask, densest_disc
from cellpilot.maps.schema import RadioMap, make_map

LATITUDE, LONGITUDE, SINR, RSRP = "Latitude", "Longitude", "RS SNR", "RSRP (LTE pcell)"
MISSING = {"", "n/a", "na", "nan", "null", "-"}
RANGES = {LATITUDE: (-90.0, 90.0), LONGITUDE: (-180.0, 180.0), SINR: (-100.0, 100.0), RSRP: (-200.0, 0.0)}
"""Beyond these a number is of a wrong column or stands for a missing value [deg, deg, dB, dBm]."""

UNITS = {LATITUDE: "deg", LONGITUDE: "deg", SINR: "dB", RSRP: "dBm"}
FOOTER_MARKER = "exported measurements"
FOOTER_PATH = re.compile(r"([A-Za-z]:)?[\\/]")
ALTITUDE_IN_NAME = re.compile(r"(?:^|_)(\d+(?:\.\d+)?)m$", re.IGNORECASE)

FloatArray = NDArray[np.float64]


@dataclass(frozen=True)
class LogTable:
    """The samples of one log: `[n]` with SINR, and apart from them `[m]` with RSRP; NaN nowhere."""

    latitude_deg: FloatArray  # [n]
    longitude_deg: FloatArray  # [n]
    altitude_m: FloatArray  # [n] the same height throughout
    sinr_db: FloatArray  # [n]
    rsrp_latitude_deg: FloatArray  # [m]
    rsrp_longitude_deg: FloatArray  # [m]
    rsrp_dbm: FloatArray  # [m]
    account: LogAccount


def read_log(path: str | Path, altitude_m: float | None = None) -> LogTable:
    """The samples of one drive-test log at one height.

    The height [m above the take-off point] is `altitude_m`, else it is read from a file name like `30m.csv` or
    `field_30m.csv`. Lines without a position, with a position of exactly 0, 0 (no fix), without SINR or RSRP, and the
    export's notes are left out and counted. `InputError` with file, line and field for a missing or empty file, a
    missing column, a broken line, text or an impossible value in a numeric field, fewer than two SINR samples, or no height.
    """
    path = Path(path)
    columns, rows = _open(path)
    height_m = _altitude(path, altitude_m)
    sinr: list[tuple[float, float, float]] = []
    rsrp: list[tuple[float, float, float]] = []
    dropped: Counter[str] = Counter()
    n_rows = rsrp_rows = 0
    for line, row in rows:
        n_rows += 1
        if _is_footer(row):
            dropped["export notes"] += 1
            continue
        latitude_deg, longitude_deg, sinr_db, rsrp_dbm = _numbers(path, line, row, columns)
        if latitude_deg is None or longitude_deg is None:
            dropped["without position"] += 1
        elif latitude_deg == 0 and longitude_deg == 0:
            dropped["at position 0, 0 (no fix)"] += 1
        elif sinr_db is None and rsrp_dbm is None:
            dropped["without SINR or RSRP"] += 1
        else:
            rsrp_rows += sinr_db is None
            if sinr_db is not None:
                sinr.append((latitude_deg, longitude_deg, sinr_db))
            if rsrp_dbm is not None:
                rsrp.append((latitude_deg, longitude_deg, rsrp_dbm))
    if len(sinr) < 2:
        raise InputError(
            f"{path}: {len(sinr)} usable value(s) of {SINR!r} in {n_rows} line(s); expected at least 2 with a position"
        )
    account = LogAccount(path.name, height_m, n_rows, len(sinr), rsrp_rows, dict(dropped))
    latitude, longitude, values = np.array(sinr).T
    rsrp_latitude, rsrp_longitude, rsrp_values = np.array(rsrp, dtype=np.float64).reshape(-1, 3).T
    heights_m = np.full(len(sinr), height_m)
    return LogTable(latitude, longitude, heights_m, values, rsrp_latitude, rsrp_longitude, rsrp_values, account)


def _altitude(path: Path, altitude_m: float | None) -> float:
    if altitude_m is not None:
        if not isfinite(altitude_m) or altitude_m < 0:
            raise InputError(f"{path}: the altitude given is {altitude_m:g} m; expected 0 m or more above take-off")
        return float(altitude_m)
    found = ALTITUDE_IN_NAME.search(path.stem)
    if found is None:
        raise InputError(
            f"{path}: the file name gives no height; expected a name like 30m.csv or field_30m.csv, or use --altitude"
        )
    return float(found[1])


def _open(path: Path) -> tuple[dict[str, int], Iterator[tuple[int, list[str]]]]:
    """Index of each column that is read (and of the last one), and the lines below the header."""
    if not path.is_file():
        raise InputError(f"{path}: {'not a file' if path.exists() else 'no such file'}; expected a drive-test log (.csv)")
    rows = _rows(path)
    line, header = next(rows, (1, []))
    if not header:
        raise InputError(f"{path}: the file is empty; expected a drive-test log with the columns {LATITUDE}, {LONGITUDE}, {SINR}")
    names = [name.strip() for name in header]
    for name in (LATITUDE, LONGITUDE, SINR):
        if name not in names:
            shown = ", ".join(repr(found) for found in names[:4]) + (", ..." if len(names) > 4 else "")
            raise InputError(
                f"{path}, line {line}: no column {name!r}; found {len(names)} column(s): {shown};"
                " export the log as comma-separated text with that column"
            )
    columns = {name: names.index(name) for name in (LATITUDE, LONGITUDE, SINR)}
    columns[RSRP] = names.index(RSRP) if RSRP in names else -1
    return columns | {"width": len(names)}, rows


def _rows(path: Path) -> Iterator[tuple[int, list[str]]]:
    """Line number and fields of every line that is not blank; a byte-order mark is taken off."""
    reader = None
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            reader = csv.reader(file)
            for row in reader:
                if any(field.strip() for field in row):
                    yield reader.line_num, row
    except (UnicodeDecodeError, csv.Error) as error:
        line = reader.line_num + 1 if reader else 1
        raise InputError(f"{path}, line {line}: not readable as text ({error}); expected comma-separated UTF-8") from None
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error}): check the file and its permissions") from None


def _is_footer(row: list[str]) -> bool:
    # Recognised by what it says, not where it stands: files get sorted, shuffled and joined.
    first = row[0].strip()
    return first.lower() == FOOTER_MARKER or FOOTER_PATH.match(first) is not None


def _numbers(path: Path, line: int, row: list[str], columns: dict[str, int]) -> list[float | None]:
    """Latitude, longitude, SINR and RSRP of a line, None where missing."""
    if len(row) != columns["width"]:
        raise InputError(
            f"{path}, line {line}: {len(row)} field(s); expected {columns['width']} as in the header: remove or complete the line"
        )
    fields = (LATITUDE, LONGITUDE, SINR, RSRP)
    return [None if columns[name] < 0 else _number(path, line, name, row[columns[name]]) for name in fields]


def _number(path: Path, line: int, name: str, text: str) -> float | None:
    text = text.strip()
    if text.lower() in MISSING:
        return None
    low, high = RANGES[name]
    wanted = f"expected a number from {low:g} to {high:g} {UNITS[name]}, or nothing"
    try:
        # Python would read 1_0 as ten.
        value = float(text.replace("_", "?"))
    except ValueError:
        raise InputError(f"{path}, line {line}: {name} is {text!r}; {wanted}: correct or remove the line") from None
    if not low <= value <= high:
        raise InputError(f"{path}, line {line}: {name} is {text}; {wanted}: correct or remove the line")
    return value


def import_logs(
    paths: Sequence[str | Path],
    *,
    altitude_m: float | Sequence[float] | None = None,
    bin_m: float = 40.0,
    fill_radius_m: float = 80.0,
    mask: str | tuple[float, float, float] | None = "auto",
    unknown: str = "blocked",
    anchor: Anchor | None = None,
) -> RadioMap:
    """A RadioMap of the logs: the mean SINR of each bin and height, holes filled from neighbours.

    `altitude_m`: one height for all files or one for each; else from the file names (see `read_log`). `mask`: "auto"
    leaves out the disc in which the drone hovered, if it did (see `hover.densest_disc`); (latitude [deg], longitude
    [deg], radius [m]) leaves out that one; None nothing. The bins that lose their samples are filled like any hole.
    `anchor`: where x = y = 0 and a bin corner lies; else the centre of the densest disc, masked or not, so that
    neither the order of the lines nor their spread over files moves a bin. `fill_radius_m`, `unknown`: see `fill`.

    `sinr_std_db` is the standard error of the bin mean, with one pseudo-sample of the map's pooled variance: a bin of
    one sample gets the pooled spread, and two equal samples are not taken for certainty. Samples of one pass are
    correlated, so it is a lower bound. `account_of` gives what was kept, dropped, masked and filled.
    `InputError` for anything `read_log`, `grid_samples`, `fill` or `validate` refuse, a file given twice, or a mask
    that holds every sample.
    """
    tables = _read_all([Path(path) for path in paths], altitude_m)
    latitude_deg, longitude_deg, height_m, sinr_db = (
        np.concatenate([getattr(table, name) for table in tables])
        for name in ("latitude_deg", "longitude_deg", "altitude_m", "sinr_db")
    )
    densest, hovering = densest_disc(latitude_deg, longitude_deg)
    disc = _mask(mask, densest if hovering else None)
    anchor = anchor or Anchor(densest.latitude_deg, densest.longitude_deg)
    keep = np.ones(sinr_db.size, bool) if disc is None else ~disc.holds(latitude_deg, longitude_deg)
    if not keep.any():
        raise InputError(f"the mask holds all {keep.size} samples: give a smaller radius or no mask")
    x_m, y_m = to_local(latitude_deg, longitude_deg, anchor)
    bins = grid_samples(x_m, y_m, height_m, sinr_db, bin_m, keep)
    measured = make_map(
        bins.mean,
        x_m=bins.x_m,
        y_m=bins.y_m,
        z_m=bins.z_m,
        sinr_std_db=_standard_error(bins),
        count=bins.count,
        optional={"sinr_spread_db": bins.std},
        anchor=anchor,
        source="measured log",
        model=f"mean RS SNR per bin of {bin_m:g} m",
        attributes={"bin_m": float(bin_m)} | _mask_attributes(disc, int((~keep).sum())),
    )
    result = fill(measured, fill_radius_m, unknown=unknown)
    logs = tuple(sorted((table.account for table in tables), key=lambda log: (log.altitude_m, log.file)))
    spot = None if disc is None else (disc.latitude_deg, disc.longitude_deg, disc.radius_m)
    account = ImportAccount(logs, int((~keep).sum()), spot, mask == "auto" and disc is not None, _levels(result))
    result.attrs[ATTRIBUTE] = account.to_json()
    return result


def _read_all(paths: list[Path], altitude_m: float | Sequence[float] | None) -> list[LogTable]:
    if not paths:
        raise InputError("no log given; expected one CSV file per flight height")
    heights_m = list(altitude_m) if isinstance(altitude_m, Sequence) else [altitude_m] * len(paths)
    if len(heights_m) != len(paths):
        raise InputError(f"{len(heights_m)} altitudes for {len(paths)} log(s); expected one for all or one for each")
    seen: set[Path] = set()
    for path in paths:
        if path.resolve() in seen:
            raise InputError(f"{path}: the log is given twice, which would count its samples twice: leave one out")
        seen.add(path.resolve())
    return [read_log(path, height_m) for path, height_m in zip(paths, heights_m, strict=True)]


def _mask(wanted: str | tuple[float, float, float] | None, hover: Mask | None) -> Mask | None:
    if isinstance(wanted, str):
        if wanted != "auto":
            raise InputError(f"the mask is {wanted!r}; expected 'auto', nothing, or latitude, longitude [deg] and radius [m]")
        return hover
    return None if wanted is None else Mask(*wanted)


def _mask_attributes(disc: Mask | None, masked: int) -> dict[str, str | int | float]:
    if disc is None:
        return {"masked_count": 0}
    return {"masked_count": masked, **{f"mask_{name}": value for name, value in asdict(disc).items()}}


def _standard_error(bins: Bins) -> FloatArray:
    several = bins.count > 1
    freedom = np.where(several, bins.count - 1, 0)
    squares = freedom * np.where(several, bins.std, 0.0) ** 2
    if several.any():
        pooled_variance = squares.sum() / freedom.sum()
    else:
        # No bin shows its spread; the bins' own differences bound it from above.
        pooled_variance = np.nanvar(bins.mean, ddof=1) if (bins.count > 0).sum() > 1 else 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        return np.where(bins.count > 0, np.sqrt((squares + pooled_variance) / bins.count**2.0), np.nan)


def _levels(dataset: RadioMap) -> tuple[LevelAccount, ...]:
    blocked, filled = dataset["blocked"].values, dataset["filled"].values
    counted = {
        "measured": dataset["count"].values > 0,
        "filled": filled,
        "blocked": blocked,
        "bad": np.isnan(dataset["sinr_db"].values) & ~blocked,
    }
    per_level = {name: cells.sum(axis=(1, 2)) for name, cells in counted.items()}
    return tuple(
        LevelAccount(float(height_m), **{name: int(cells[iz]) for name, cells in per_level.items()})
        for iz, height_m in enumerate(dataset["z"].values)
    )
