import ast
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from cellpilot import __version__
from cellpilot.provenance import digest, versions
from cellpilot.units import THERMAL_NOISE_DBM_HZ, from_db, to_db


def test_digest_depends_on_values_shapes_types_and_order() -> None:
    a, b = np.arange(6, dtype=np.float32), np.zeros(2, np.float32)
    base = digest([a, b])
    assert base == digest([a.copy(), b.copy()])
    changed = a.copy()
    changed[3] += 1e-5
    others = [[changed, b], [a.reshape(2, 3), b], [a.astype(np.float64), b], [b, a], [a]]
    assert len({base, *(digest(arrays) for arrays in others)}) == 1 + len(others)
    assert digest([np.arange(12).reshape(3, 4).T]) == digest([np.ascontiguousarray(np.arange(12).reshape(3, 4).T)])


def test_versions_name_what_computes() -> None:
    found = versions()
    assert found["numpy"] == np.__version__
    assert {"python", "jax", "scipy"} <= set(found)
    assert found["cellpilot"] == __version__


ROOT = Path(__file__).parents[2]


def test_version_stands_in_one_place() -> None:
    built = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert "version" not in built["project"]
    assert built["project"]["dynamic"] == ["version"]
    assert built["tool"]["hatch"]["version"]["path"] == "src/cellpilot/__init__.py"
    assert re.findall(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(), re.MULTILINE) == [__version__]
    stated = [
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path in (ROOT / "src").rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text()))
        if isinstance(node, ast.Constant) and node.value == __version__
    ]
    assert len(stated) == 1, stated


@given(st.floats(-150.0, 150.0))
def test_decibels_round_trip(level_db: float) -> None:
    assert float(to_db(from_db(level_db))) == pytest.approx(level_db, abs=1e-9)


def test_decibels_by_hand() -> None:
    np.testing.assert_allclose(to_db([1.0, 10.0, 2.0, 0.0]), [0.0, 10.0, 3.0103, -np.inf], atol=1e-5)
    np.testing.assert_allclose(from_db([0.0, 30.0, -np.inf]), [1.0, 1000.0, 0.0])
    assert THERMAL_NOISE_DBM_HZ == -174.0
