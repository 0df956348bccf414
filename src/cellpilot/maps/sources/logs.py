"""Measured logs of any known kind as one tidy table: recognised by their header, every line kept or counted with the reason."""

import re
from collections import Counter
from dataclasses import dataclass
from datetime import date
from math import inf, isfinite, nan
from pathlib import Path

import numpy as np

from cellpilot.errors import InputError
from cellpilot.maps.account import LogAccount
from cellpilot.maps.geodesy import farthest_from_the_rest
from cellpilot.maps.samples import STATED, Samples
from cellpilot.maps.settings import LOGS
from cellpilot.maps.sources.drive_test import DRIVE_TEST
from cellpilot.maps.sources.gnettrack import GNETTRACK
from cellpilot.maps.sources.log_format import LogFormat
from cellpilot.maps.sources.network_survey import NETWORK_SURVEY_LTE, NETWORK_SURVEY_NR
from cellpilot.maps.text_table import LATITUDE_DEG, LONGITUDE_DEG, Column, Table, TextRow, open_table

LOG_FORMATS = (DRIVE_TEST, GNETTRACK, NETWORK_SURVEY_LTE, NETWORK_SURVEY_NR)
"""A new kind of log is one file beside this one and its line here."""

FARTHEST_SAMPLE_KM = 200.0
"""No flight leads farther from the middle of its log: exchanged coordinates do."""

DAY = re.compile(r"(20\d\d)[-./](0[1-9]|1[0-2])[-./](0[1-9]|[12]\d|3[01])(?!\d)")
"""The day that a time begins with, as in 2020-02-14T12:58:17 and 2020.02.14_12.58.17."""

HIGHEST_M = 10_000.0
HEIGHT_IN_NAME = re.compile(r"(?:^|_)(\d+(?:\.\d+)?)m$", re.IGNORECASE)


@dataclass(frozen=True)
class LogOptions:
    """What the person who imports a log says about it; None = as the log says."""

    altitude_m: float | None = None
    """Height of all samples above take-off [m], whatever the log says."""
    format: LogFormat | None = None
    max_accuracy_m: float = LOGS.max_accuracy_m
    """Samples at less certain positions are left out."""
    max_age_s: float = LOGS.max_age_s
    """Samples at older positions are left out."""


def read_log(path: str | Path, options: LogOptions = LogOptions()) -> tuple[Samples, LogAccount]:
    """The samples of one log with a position and SINR or RSRP, and what became of every line.

    `altitude_m` of the samples [m] is the height given, else the log's own altitude, else that in the file's name (kinds
    that have it there); `altitude_reference` says what it counts from. Left out and counted: notes, lines without position
    or with position 0, 0, without SINR and RSRP, without altitude, of neighbour cells, and at positions that are older or
    less certain than allowed. Sentinels such as 2147483647 stand for no value. `InputError` with file, line and field for a
    missing or empty file, an unknown header, a broken line, text or an impossible value in a numeric field, a position far
    from all others, fewer than two SINR samples, or a height that nobody states.
    """
    path = Path(path)
    table, rows = open_table(path, "measured log")
    log_format = options.format or _recognised(table)
    _check_columns(table, log_format)
    dropped: Counter[str] = Counter()
    kept: list[tuple[object, ...]] = []
    lines: list[int] = []
    n_rows = 0
    for row in rows:
        n_rows += 1
        values = _sample(row, log_format, options)
        if isinstance(values, str):
            dropped[values] += 1
        else:
            kept.append(values)
            lines.append(row.line)
    with_sinr = sum(isfinite(values[3]) for values in kept)  # type: ignore[arg-type]
    if with_sinr < 2:
        raise InputError(
            f"{path}: {with_sinr} usable value(s) of {log_format.sinr.name!r} in {n_rows} line(s);"
            " expected at least 2 with a position" + "".join(f"; {count} {reason}" for reason, count in sorted(dropped.items()))
        )
    samples = _table(path, log_format, kept, options)
    _check_together(path, lines, samples)
    altitudes_m = (float(samples.altitude_m.min()), float(samples.altitude_m.max()))
    account = LogAccount(
        file=path.name,
        kind=log_format.name,
        altitude_m=altitudes_m,
        rows=n_rows,
        kept=with_sinr,
        rsrp_rows=len(kept) - with_sinr,
        dropped=dict(dropped),
        days=_days(samples.time.tolist()),
    )
    return samples, account


def _sample(row: TextRow, f: LogFormat, options: LogOptions) -> tuple[object, ...] | str:
    """Time, latitude, longitude, SINR, RSRP, RSRQ, altitude and cell of a line, or why it is left out."""
    if f.is_note(row.fields):
        return "notes"
    row.check_width()
    if row.text(f.serving).lower() == "false":
        return "of neighbour cells"
    latitude_deg = row.number(Column(f.latitude, *LATITUDE_DEG, "deg"))
    longitude_deg = row.number(Column(f.longitude, *LONGITUDE_DEG, "deg"))
    if not (isfinite(latitude_deg) and isfinite(longitude_deg)):
        return "without position"
    if latitude_deg == 0 and longitude_deg == 0:
        return "at position 0, 0 (no fix)"
    if f.accuracy and row.number(Column(f.accuracy, 0.0, inf, "m")) > options.max_accuracy_m:
        return f"at positions uncertain by more than {options.max_accuracy_m:g} m"
    if f.age and row.number(Column(f.age, 0.0, inf, "ms")) > 1000 * options.max_age_s:
        return f"at positions older than {options.max_age_s:g} s"
    sinr_db, rsrp_dbm, rsrq_db, altitude = (
        nan if column is None else row.number(column) for column in (f.sinr, f.rsrp, f.rsrq, f.altitude)
    )
    if not (isfinite(sinr_db) or isfinite(rsrp_dbm)):
        return "without SINR or RSRP"
    if f.altitude is not None and options.altitude_m is None and not isfinite(altitude):
        return "without altitude"
    return row.text(f.time), latitude_deg, longitude_deg, sinr_db, rsrp_dbm, rsrq_db, altitude, row.text(f.cell)


def _days(times: list[str]) -> tuple[str, str] | None:
    found = [DAY.match(time) for time in times]
    days = {"-".join(match.groups()) for match in found if match is not None}
    return (min(days), max(days)) if days and None not in found and all(map(_exists, days)) else None


def _exists(day: str) -> bool:
    try:
        date.fromisoformat(day)
    except ValueError:
        return False
    return True


def _recognised(table: Table) -> LogFormat:
    fitting = [f for f in LOG_FORMATS if set(f.signature) <= set(table.names)]
    if not fitting:
        known = "; ".join(f"{f.name}: {', '.join(f.signature)}" for f in LOG_FORMATS)
        raise InputError(
            f"{table.path}: a log of unknown kind with {table.shown()}; known are {known};"
            " or name the columns: `columns` lat=..,lon=..,alt=..,sinr=.."
        )
    return max(fitting, key=lambda f: len(f.signature))


def _check_columns(table: Table, f: LogFormat) -> None:
    needed = [f.latitude, f.longitude, f.sinr.name]
    if not f.signature:  # named by hand: every name is meant
        needed += [column.name for column in (f.rsrp, f.rsrq, f.altitude) if column is not None]
        needed += [name for name in (f.cell, f.time, f.accuracy) if name is not None]
    table.require(tuple(needed))


def _table(path: Path, f: LogFormat, kept: list[tuple[object, ...]], options: LogOptions) -> Samples:
    time, latitude, longitude, sinr, rsrp, rsrq, altitude, cell = (np.array(column) for column in zip(*kept, strict=True))
    stated_m = _stated_height_m(path, f, options)
    altitude_m = altitude * f.metres_per_unit if stated_m is None else np.full(len(kept), stated_m)
    references = np.full(len(kept), f.altitude_reference if stated_m is None else STATED)
    source = np.full(len(kept), path.name)
    return Samples(time, latitude, longitude, altitude_m, references, sinr, rsrp, rsrq, cell, source)


def _stated_height_m(path: Path, f: LogFormat, options: LogOptions) -> float | None:
    """Height above take-off [m] of the whole log as given or as its name says; None where the log has altitudes of its own."""
    if options.altitude_m is not None:
        if not 0 <= options.altitude_m <= HIGHEST_M:
            raise InputError(
                f"{path}: the altitude given is {options.altitude_m:g} m; expected 0 to {HIGHEST_M:,.0f} m above take-off"
            )
        return float(options.altitude_m)
    if f.altitude is not None:
        return None
    found = HEIGHT_IN_NAME.search(Path(path.name.removesuffix(".gz")).stem) if f.height_in_name else None
    if found is None:
        named = "; the file name gives none, like 30m.csv or field_30m.csv would" if f.height_in_name else ""
        raise InputError(f"{path}: the log has no height{named}: give `altitude_m` METRES above take-off")
    if float(found[1]) > HIGHEST_M:
        raise InputError(f"{path}: the file name gives a height of {found[1]} m; expected at most {HIGHEST_M:,.0f} m: rename it")
    return float(found[1])


def _check_together(path: Path, lines: list[int], samples: Samples) -> None:
    row, distance_km = farthest_from_the_rest(samples.latitude_deg, samples.longitude_deg)
    if distance_km > FARTHEST_SAMPLE_KM:
        raise InputError(
            f"{path}, line {lines[row]}: latitude {samples.latitude_deg[row]:g}, longitude {samples.longitude_deg[row]:g} lies"
            f" {distance_km:,.0f} km from the middle of the log; expected at most {FARTHEST_SAMPLE_KM:g} km: are they exchanged?"
        )
