"""`cellpilot map convert`: every format into every other, and wrong input."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import rasterio
from cli_tools import Cli, assert_refused, tree

from cellpilot.maps import Anchor, load_map, make_map, save_map

SUFFIXES = (".nc", ".zarr", ".csv", ".tif", ".tiff")
FLIGHT = ("--start", "0,0,0", "--goal", "3,3,0", "--task.threshold-db", "0", "--json")


@pytest.fixture
def desk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working directory: a map with an anchor, uncertain and partly forbidden, one without, and a raster from elsewhere."""
    monkeypatch.chdir(tmp_path)
    sinr_db = np.arange(16, dtype=np.float32).reshape(1, 4, 4)
    blocked = np.zeros((1, 4, 4), bool)
    blocked[0, 1:3, 1] = True
    axes = {"x_m": np.arange(4) * 20.0, "y_m": np.arange(4) * 20.0, "z_m": [30.0], "source": "test"}
    known = {"sinr_std_db": 2.5, "count": np.arange(16).reshape(1, 4, 4), "filled": sinr_db > 12, "blocked_reason": blocked}
    save_map(make_map(sinr_db, **axes, **known, anchor=Anchor(50, 7)), tmp_path / "map.nc")
    save_map(make_map(sinr_db, **axes), tmp_path / "nowhere.nc")
    profile = {"count": 2, "height": 4, "width": 4, "dtype": "float32", "crs": "EPSG:4326"}
    with rasterio.open("raster.tif", "w", driver="GTiff", transform=rasterio.Affine(2e-4, 0, 7, 0, -2e-4, 50), **profile) as file:
        file.write(np.concatenate([sinr_db, sinr_db + 1]))
    return tmp_path


@pytest.mark.parametrize(("source", "target"), list(product(SUFFIXES, SUFFIXES)))
def test_every_format_into_every_other(desk: Path, cli: Cli, source: str, target: str) -> None:
    if source != ".nc":
        assert cli("map", "convert", "map.nc", f"map{source}").code == 0
    result = cli("map", "convert", f"map{source}", f"new{target}")
    assert (result.code, result.err) == (0, "")
    assert f"map: new{target}" in result.out
    original, converted = load_map(desk / "map.nc"), load_map(desk / f"new{target}")
    assert converted.identical(original)


def test_a_plan_on_a_raster_keeps_away_from_what_is_forbidden(desk: Path, cli: Cli) -> None:
    assert cli("map", "convert", "map.nc", "map.tif").code == 0
    plans = [cli("plan", name, *FLIGHT) for name in ("map.nc", "map.tif")]
    assert [plan.code for plan in plans] == [0, 0], plans
    first, second = (json.loads(plan.out.replace("map.tif", "map.nc")) for plan in plans)
    assert first == second
    result = cli("plan", "map.tif", "--start", "1,1,0", "--goal", "3,3,0")
    assert_refused(result, "blocked")


def test_one_variable(desk: Path, cli: Cli) -> None:
    for name in ("sinr_db", "sinr_std_db", "blocked_reason"):
        assert cli("map", "convert", "map.nc", f"{name}.tif", "--variable", name).code == 0
        with rasterio.open(desk / f"{name}.tif") as file:
            np.testing.assert_array_equal(file.read(), load_map(desk / "map.nc")[name].values[:, ::-1])


def test_heights_of_a_raster_from_elsewhere(desk: Path, cli: Cli) -> None:
    assert cli("map", "convert", "raster.tif", "new.nc", "--heights-m", "30", "45.5").code == 0
    new = load_map(desk / "new.nc")
    assert new["z"].values.tolist() == [30.0, 45.5]
    assert not new["blocked_reason"].any()
    assert cli("map", "convert", "new.nc", "new.tif").code == 0
    assert cli("map", "convert", "new.tif", "again.nc", "--heights-m", "30", "45.5").code == 0
    assert load_map(desk / "again.nc").identical(new)


REFUSED = [
    (("map.nc", "new.xlsx"), ["new.xlsx", ".tif"]),
    (("map.nc", "new"), ["new", ".tif"]),
    (("raster.jpg", "new.nc"), ["raster.jpg", ".tif"]),
    (("gone.nc", "new.tif"), ["gone.nc", "no such file"]),
    (("gone.tif", "new.nc"), ["gone.tif", "no such file"]),
    (("gone.tif", "new.nc", "--heights-m", "30"), ["gone.tif", "no such file"]),
    (("nowhere.nc", "new.tif"), ["new.tif", "anchor"]),
    (("nowhere.nc", "new.tif", "--variable", "count"), ["new.tif", "anchor"]),
    (("raster.tif", "new.nc"), ["raster.tif", "2 band(s) without a height", "--heights-m"]),
    (("raster.tif", "new.nc", "--heights-m", "30"), ["raster.tif", "2 band(s), and 1 height(s)"]),
    (("raster.tif", "new.nc", "--heights-m", "30", "30"), ["raster.tif", "30, 30 m", "once"]),
    (("raster.tif", "new.nc", "--heights-m", "high"), ["--heights-m", "high"]),
    (("stated.tif", "new.nc", "--heights-m", "40"), ["stated.tif", "30 m", "40 m", "--heights-m"]),
    (("map.nc", "new.csv", "--heights-m", "30"), ["map.nc", "heights", "GeoTIFF"]),
    (("map.nc", "new.csv", "--variable", "count"), ["new.csv", "variable", "GeoTIFF"]),
    (("map.nc", "new.tif", "--variable", "rsrp_dbm"), ["new.tif", "no rsrp_dbm"]),
    (("map.nc", "new.tif", "--variable", "x"), ["new.tif", "no x"]),
    (("map.nc", "stated.tif/new.tif"), ["new.tif", "cannot be written"]),
    (("map.nc", "stated.tif/new.tif", "--variable", "count"), ["new.tif", "cannot be written"]),
    (("map.nc",), ["Missing", "map to write"]),
]


@pytest.mark.parametrize(("arguments", "named"), REFUSED)
def test_what_is_refused(desk: Path, cli: Cli, arguments: tuple[str, ...], named: list[str]) -> None:
    assert cli("map", "convert", "map.nc", "stated.tif").code == 0
    before = tree(desk)
    assert_refused(cli("map", "convert", *arguments), *named)
    assert tree(desk) == before
