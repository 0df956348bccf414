"""What a reader of logs has to state about its format; how lines are read is the same for all of them (`logs.py`)."""

from collections.abc import Callable
from dataclasses import dataclass

from cellpilot.maps.text_table import Column


def sinr(name: str) -> Column:
    """SINR [dB]; LTE reports -20 to 30 dB, NR -23 to 40 dB, scanners somewhat more."""
    return Column(name, -50.0, 70.0, "dB")


def rsrp(name: str) -> Column:
    """RSRP [dBm]; 3GPP reports -156 to -31 dBm."""
    return Column(name, -200.0, 0.0, "dBm")


def rsrq(name: str) -> Column:
    """RSRQ [dB]; 3GPP reports -43 to 20 dB."""
    return Column(name, -60.0, 30.0, "dB")


@dataclass(frozen=True)
class LogFormat:
    """One kind of log, recognised by its columns."""

    name: str
    signature: tuple[str, ...]
    """Columns of the header that make a file one of this kind; the format with the most of them wins."""
    latitude: str
    longitude: str
    sinr: Column
    rsrp: Column | None = None
    rsrq: Column | None = None
    cell: str | None = None
    time: str | None = None
    altitude: Column | None = None
    altitude_reference: str = ""
    metres_per_unit: float = 1.0
    """Of the altitude column."""
    accuracy: str | None = None
    """Uncertainty of the position [m]."""
    age: str | None = None
    """Age of the position [ms]."""
    serving: str | None = None
    """"true" in the rows of the serving cell; rows that say "false" tell of neighbours."""
    is_note: Callable[[list[str]], bool] = lambda row: row[0].lstrip().startswith("#")
    """Lines that are remarks of the logging program."""
    height_in_name: bool = False
    """The name of the file states the height above take-off, as in 30m.csv."""
