"""What became of every line of an imported log, for people to read and for files to keep."""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from datetime import date
from typing import Any

from cellpilot.errors import InputError
from cellpilot.maps.schema import RadioMap

ATTRIBUTE = "import_account"


@dataclass(frozen=True)
class LogAccount:
    """Lines of one log: `rows` = `kept` + `rsrp_rows` + all of `dropped`."""

    file: str  # name without the folder
    kind: str  # name of the format
    altitude_m: tuple[float, float]  # lowest and highest sample
    rows: int  # lines after the header that are not blank
    kept: int  # a SINR value at a position
    rsrp_rows: int  # RSRP at a position, no SINR: kept apart, never paired with SINR
    dropped: Mapping[str, int]  # reason -> lines
    days: tuple[str, str] | None = None  # first and last day of a sample (YYYY-MM-DD), where the log dates them

    def heights(self) -> str:
        """Height or heights in words."""
        low_m, high_m = self.altitude_m
        return f"{low_m:g} m" if low_m == high_m else f"{low_m:.1f} to {high_m:.1f} m"


@dataclass(frozen=True)
class LevelAccount:
    """Cells of one height."""

    height_m: float
    measured: int
    filled: int
    blocked: int
    bad: int  # free, SINR unknown, counted as below every threshold


@dataclass(frozen=True)
class ImportAccount:
    """Everything an import read, left out and made of it."""

    logs: tuple[LogAccount, ...]
    masked: int  # samples within the mask
    mask: tuple[float, float, float] | None  # latitude [deg], longitude [deg], radius [m]
    mask_found: bool  # the import found it; False: it was given
    levels: tuple[LevelAccount, ...]

    @property
    def kept(self) -> int:
        """SINR samples read, the masked ones included."""
        return sum(log.kept for log in self.logs)

    @property
    def days(self) -> tuple[str, str] | None:
        """First and last day of all samples, YYYY-MM-DD; None if a log does not date them."""
        found = [log.days for log in self.logs]
        dated = [days for days in found if days is not None]
        if not dated or len(dated) < len(found):
            return None
        return min(first for first, _ in dated), max(last for _, last in dated)

    def lines(self) -> list[str]:
        """The account as lines of text."""
        text = [
            f"{log.file} ({log.kind}) at {log.heights()}: {log.rows} lines, {log.kept} SINR samples kept,"
            f" {log.rsrp_rows} with RSRP only" + "".join(f", {count} {reason}" for reason, count in sorted(log.dropped.items()))
            for log in self.logs
        ]
        if self.mask is None:
            text.append("mask: none")
        else:
            latitude_deg, longitude_deg, radius_m = self.mask
            text.append(
                f"mask: {self.masked} of {self.kept} samples ({self.masked / self.kept:.1%}) within {radius_m:g} m of"
                f" {latitude_deg:.6f}, {longitude_deg:.6f} left out ({'hover found' if self.mask_found else 'as given'})"
            )
        text += [
            f"{level.height_m:g} m: {level.measured} cells measured, {level.filled} filled, {level.blocked} blocked"
            + (f", {level.bad} unknown and counted as bad" if level.bad else "")
            for level in self.levels
        ]
        return text

    def to_json(self) -> str:
        """One line of JSON that `from_json` reads."""
        return json.dumps(asdict(self), sort_keys=True)

    @classmethod
    def from_json(cls, text: str) -> "ImportAccount":
        """The account in one line of JSON."""
        data = json.loads(text)
        data["logs"] = tuple(_log_account(log) for log in data["logs"])
        data["levels"] = tuple(LevelAccount(**level) for level in data["levels"])
        data["mask"] = None if data["mask"] is None else tuple(data["mask"])
        return cls(**data)


def _log_account(log: dict[str, Any]) -> LogAccount:
    altitude_m = log["altitude_m"]
    # Version 0.1.0 knew one kind of log, at one height.
    heights_m = tuple(altitude_m) if isinstance(altitude_m, list) else (altitude_m, altitude_m)
    days = None if log.get("days") is None else tuple(log["days"])
    return LogAccount(**{"kind": "drive-test export"} | log | {"altitude_m": heights_m, "days": days})


def account_of(dataset: RadioMap) -> ImportAccount:
    """The account stored with an imported map; `InputError` for a map that was not imported from logs."""
    if ATTRIBUTE not in dataset.attrs:
        raise InputError(f"the map has no attribute {ATTRIBUTE!r}: only maps imported from logs keep an account")
    return parsed_account(dataset.attrs[ATTRIBUTE], "the map")


def parsed_account(text: str, where: str) -> ImportAccount:
    """The account in an attribute; `InputError` if it is none."""
    try:
        account = ImportAccount.from_json(text)
        account.lines()  # uses every entry, and so finds one of another kind
        if account.days is not None:
            date.fromisoformat(account.days[1])
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, ZeroDivisionError) as error:
        raise InputError(
            f"{where}: the attribute {ATTRIBUTE} is no account of an import ({error!r:.80}); import the logs again, or remove it"
        ) from None
    return account
