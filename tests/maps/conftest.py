"""Small maps and logs that several test files use."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from maps_logs import HEADER, WriteLog

from cellpilot.maps import RadioMap, make_map


@pytest.fixture
def write_log(tmp_path: Path) -> WriteLog:
    """Write data lines below a header and return the path."""

    def write(lines: Sequence[str], name: str = "30m.csv", header: str = HEADER, mark: bytes = b"") -> Path:
        path = tmp_path / name
        path.write_bytes(mark + "\n".join([header, *lines, ""]).encode())
        return path

    return write


@pytest.fixture
def small_map() -> RadioMap:
    """Two heights of 3 x 4 cells of 20 m; one cell of each height is unknown."""
    sinr_db = np.arange(24, dtype=np.float32).reshape(2, 3, 4) - 12
    sinr_db[:, 1, 2] = np.nan
    return make_map(sinr_db, x_m=np.arange(4) * 20.0, y_m=np.arange(3) * 20.0, z_m=[30.0, 50.0], source="test")
