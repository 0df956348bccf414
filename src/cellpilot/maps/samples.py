"""The tidy table that every measured log becomes: one row a measurement, one column a quantity."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray

TextArray = NDArray[np.str_]

STATED, TAKE_OFF, ELLIPSOID, SEA_LEVEL = "stated", "take-off", "ellipsoid", "sea level"
"""What an altitude counts from.

Stated: one height above take-off for the whole log, from the file's name or the person who imports it. Else the log's own:
above the place where the flight began, above the WGS84 ellipsoid (as GPS gives it), or above the sea.
"""


@dataclass(frozen=True, eq=False)
class Samples:
    """Measurements, every array `[sample]`; numbers that a row does not have are NaN, texts empty."""

    time: TextArray  # as the log writes it
    latitude_deg: FloatArray  # WGS84, never NaN
    longitude_deg: FloatArray
    altitude_m: FloatArray
    altitude_reference: TextArray  # one of the four above
    sinr_db: FloatArray
    rsrp_dbm: FloatArray
    rsrq_db: FloatArray
    cell: TextArray
    source: TextArray  # name of the log

    def __len__(self) -> int:
        return len(self.latitude_deg)

    def __getitem__(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> "Samples":
        """The samples of those rows."""
        return Samples(*(getattr(self, field.name)[rows] for field in fields(self)))

    @classmethod
    def joined(cls, tables: Sequence["Samples"]) -> "Samples":
        """All rows of several tables."""
        return cls(*(np.concatenate([getattr(table, field.name) for table in tables]) for field in fields(cls)))
