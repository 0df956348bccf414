"""`cellpilot adapt`: what it leaves behind, and what it refuses."""

from pathlib import Path

import numpy as np
import pytest
import xarray as xr
from cli_tools import TINY, Cli, assert_refused, tree

FEW = ("--flights", "2", "--seeds", "2", "--arms", "map-prior", "map-nothing", "--out", "study")


def test_it_leaves_curves_maps_and_a_picture(place: Path, cli: Cli) -> None:
    call = ("adapt", "plain.nc", "blocked.nc", *FEW, "--task.threshold-db", "5")
    result = cli(*call)
    assert result.code == 0, result.err
    assert "map-prior" in result.out
    assert "mean score 0.9" in result.out
    assert "correlation" in result.out
    with xr.open_dataset(place / "study" / "adapt.nc", engine="h5netcdf") as data:
        first = data.load()
    assert first["score"].shape == (2, 2, 3)
    assert first.attrs["threshold_db"] == 5.0
    assert {path.name for path in (place / "study").iterdir()} == {"adapt", "adapt.nc", "figures", "map-a.nc", "map-b.nc"}
    assert {path.name for path in (place / "study" / "figures").iterdir()} == {"adapt.png", "adapt.pdf"}
    # Called again, it goes on: only the curve that was lost is flown, and it is the same.
    kept = {path: path.stat().st_mtime_ns for path in (place / "study" / "adapt").iterdir()}
    assert len(kept) == 4
    lost = min(kept)
    lost.unlink()
    assert cli(*call).code == 0
    assert {path for path in kept if path.stat().st_mtime_ns != kept[path]} == {lost}
    with xr.open_dataset(place / "study" / "adapt.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["score"].values, first["score"].values)
    lost.write_text("no curve")
    assert_refused(cli(*call), lost.name, "damaged")
    lost.unlink()
    # Another noise is another study.
    assert cli(*call, "--task.noise-std-db", "1").code == 0
    assert len(list((place / "study" / "adapt").iterdir())) == 7
    # The maps it leaves can be given again.
    again = cli("adapt", "study/map-a.nc", "study/map-b.nc", *FEW[:-1], "again", "--task.threshold-db", "5")
    assert again.code == 0, again.err
    with xr.open_dataset(place / "again" / "adapt.nc", engine="h5netcdf") as data:
        np.testing.assert_array_equal(data["score"].values, first["score"].values)


def test_the_task_is_that_of_scenario_b_unless_a_flag_says_otherwise(place: Path, cli: Cli) -> None:
    for flags, expected in (((), 5.0), (("--task.threshold-db", "6"), 6.0)):
        assert cli("adapt", "plain.nc", "tiny.toml", *FEW, "--arms", "map-nothing", *flags).code == 0
        with xr.open_dataset(place / "study" / "adapt.nc", engine="h5netcdf") as data:
            assert data.attrs["threshold_db"] == expected
            assert data["arm"].values.tolist() == ["map-nothing"]


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        ((), ["what was prepared on"]),
        (("plain.nc",), ["unknown truth"]),
        (("gone.nc", "plain.nc"), ["gone.nc", "no such file"]),
        (("plain.nc", "gone.csv"), ["gone.csv", "no such file"]),
        (("plain.nc", "gone"), ["gone", "no such scenario"]),
        (("tiny.toml", "thesis-2d"), ["grids differ", "100 m in A", "20 m in B"]),
        (("plain.nc", "thesis-3d"), ["heights 30 m in A"]),
        (("plain.nc", "fixed.toml"), ["fixes start or goal"]),
        (("plain.nc", "blocked.nc", "--arms", "luck"), ["luck", "map-prior"]),
        (("plain.nc", "blocked.nc", "--flights", "0"), ["--flights", "0"]),
        (("plain.nc", "blocked.nc", "--seeds", "0"), ["--seeds", "0"]),
        (("plain.nc", "blocked.nc", "--bin-m", "-1"), ["--bin-m", "-1"]),
        (("plain.nc", "blocked.nc", "--calibrate", "gone.nc"), ["gone.nc", "no such file"]),
        (("plain.nc", "blocked.nc", "--task.noise-std-db", "-2"), ["--task.noise-std-db", "-2"]),
    ],
)
def test_wrong_input_is_one_line(place: Path, cli: Cli, arguments: tuple[str, ...], named: list[str]) -> None:
    (place / "fixed.toml").write_text(TINY.replace("[task]", "[task]\nstart = [0, 0, 0]"))
    before = tree(place)
    assert_refused(cli("adapt", *arguments), *named)
    assert tree(place) == before
