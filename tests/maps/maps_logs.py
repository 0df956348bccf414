"""What the tests of logs share."""

from collections.abc import Callable
from pathlib import Path

HEADER = "Time,Latitude,Longitude,RSRP (LTE pcell),RS SNR"

WriteLog = Callable[..., Path]
