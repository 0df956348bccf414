"""Ray tracing: SINR from powers by hand, what the program says when the tracing process fails, and one real scene."""

import json
import os
import signal
import subprocess
import sys
from collections.abc import Callable
from importlib.metadata import PackageNotFoundError
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from cellpilot.errors import InputError
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_RAY, blocked_cells, reasons_of
from cellpilot.maps.sectors import sector_levels
from cellpilot.maps.sources import raytraced
from cellpilot.maps.sources.raytrace_worker import column_weights
from cellpilot.maps.sources.raytraced import Rays, map_of_powers, missing_for_raytracing, raytrace_map, try_raytracing
from cellpilot.radio import ColumnAntenna, Deployment, element_gain_dbi, hexagonal_deployment

NOISE_DBM = -174 + 70 + 9
"""Over 10 MHz, noise figure 9 dB."""
UNHEARD = -np.inf
AXES = {"x_m": np.array([0.0, 10.0, 20.0]), "y_m": np.array([5.0, 15.0])}


def mw(*levels_dbm: float) -> float:
    return sum(10 ** (level / 10) for level in levels_dbm)


def three_sectors(**changes: Any) -> Deployment:
    return hexagonal_deployment(rings=0, **changes)


class TestPowers:
    POWER_DBM = np.array(
        [
            [[-60.0, UNHEARD, UNHEARD], [-80.0, -60.0, -90.0]],
            [[-70.0, -90.0, UNHEARD], [-80.0, -70.0, UNHEARD]],
            [[UNHEARD, UNHEARD, UNHEARD], [-80.0, -50.0, UNHEARD]],
        ]
    )[:, None]
    INSIDE = np.array([[[False, False, False], [False, True, False]]])

    def test_sinr_by_hand(self) -> None:
        deployment = three_sectors(load=[1.0, 0.5, 1.0])
        radio_map = map_of_powers(
            deployment, self.POWER_DBM, **AXES, z_m=np.array([30.0]), inside=self.INSIDE, names=None, height_m=deployment.height_m
        )
        half_db = 10 * np.log10(0.5)
        expected_db = [
            [-60 - 10 * np.log10(mw(-70 + half_db, NOISE_DBM)), -90 - NOISE_DBM, np.nan],
            [-80 - 10 * np.log10(mw(-80, -80 + half_db, NOISE_DBM)), np.nan, -90 - NOISE_DBM],
        ]
        np.testing.assert_allclose(radio_map["sinr_db"].values[0], expected_db, atol=1e-5)
        assert radio_map["blocked_reason"].values[0].tolist() == [[0, 0, 2], [0, 1, 0]]
        assert reasons_of(radio_map) == (INSIDE_BUILDING, NO_RAY)
        assert radio_map["serving_sector"].values[0].tolist() == [[0, 1, -1], [0, -1, 0]]
        rsrp_dbm = radio_map["rsrp_dbm"].values[:, 0]
        np.testing.assert_allclose(rsrp_dbm[:, 0, 0], [-60 - 10 * np.log10(600), -70 - 10 * np.log10(600), np.nan], atol=1e-5)
        assert not radio_map["sinr_std_db"].values[~blocked_cells(radio_map)].any()

    def test_unheard_sectors_disturb_nobody_in_a_world_either(self) -> None:
        deployment = three_sectors()
        radio_map = map_of_powers(
            deployment, self.POWER_DBM, **AXES, z_m=np.array([30.0]), inside=self.INSIDE, names=None, height_m=deployment.height_m
        )
        levels = sector_levels(radio_map)
        assert levels is not None
        free = ~blocked_cells(radio_map).ravel()
        serving = radio_map["serving_sector"].values.ravel()[free]
        sinr_db = levels[1][:, free][serving, np.arange(free.sum())]
        np.testing.assert_allclose(sinr_db, radio_map["sinr_db"].values.ravel()[free], atol=1e-4)


def program(folder: Path, text: str) -> str:
    """An executable file."""
    path = folder / "program"
    path.write_text(text)
    path.chmod(0o755)
    return str(path)


def run_instead(
    monkeypatch: pytest.MonkeyPatch, folder: Path, shell: str, progress: Callable[[float], None] = lambda share: None
) -> Any:
    """What comes of a tracing process that does this; it is called with `-m WORKER REQUEST RESULT`."""
    monkeypatch.setattr(sys, "executable", program(folder, f"#!/bin/sh\n{shell}\n"))
    return raytraced._run({"scene": "munich"}, folder, progress)


@pytest.mark.parametrize(
    ("shell", "said"),
    [
        ("echo first >&2; echo 'RuntimeError: no such scene' >&2; echo >&2; exit 3", "failed: RuntimeError: no such scene"),
        ("kill -ABRT $$", f"was ended by signal {signal.SIGABRT:d}: is /mine/libLLVM.so LLVM of version 19 or newer?"),
        ("echo 'LLVM ERROR: bad' >&2; kill -SEGV $$", f"was ended by signal {signal.SIGSEGV:d}: is /mine/libLLVM.so"),
        ("exit 0", "failed: exit code 0 (LLVM: /mine/libLLVM.so)"),
        (r"printf '\377\n' >&2; exit 1", "failed: \N{REPLACEMENT CHARACTER} (LLVM: /mine/libLLVM.so)"),
    ],
)
def test_a_failing_process_is_named(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, shell: str, said: str) -> None:
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", "/mine/libLLVM.so")
    with pytest.raises(InputError) as caught:
        run_instead(monkeypatch, tmp_path, shell)
    assert str(caught.value).startswith(f"ray tracing {said}")
    assert "\n" not in str(caught.value)


def test_progress_is_passed_on_and_other_lines_are_not(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    shares: list[float] = []
    shell = "echo jitting; echo 'progress 0.25'; echo 'in progress'; echo 'progress 1.0000'; exit 1"
    with pytest.raises(InputError):
        run_instead(monkeypatch, tmp_path, shell, shares.append)
    assert shares == [0.25, 1.0]


@pytest.mark.parametrize("given", [None, "/mine/libLLVM.so"])
def test_the_process_is_told_of_the_llvm_that_was_found(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, given: str | None
) -> None:
    (tmp_path / "libLLVM-19.so").touch()
    monkeypatch.setattr(raytraced, "LLVM_PLACES", (f"{tmp_path}/nowhere*.so", f"{tmp_path}/libLLVM-1*.so"))
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    if given:
        monkeypatch.setenv("DRJIT_LIBLLVM_PATH", given)
    with pytest.raises(InputError) as caught:
        run_instead(monkeypatch, tmp_path, 'echo "at $DRJIT_LIBLLVM_PATH." >&2; exit 1')
    assert f"at {given or tmp_path / 'libLLVM-19.so'}. (LLVM" in str(caught.value)
    assert os.environ.get("DRJIT_LIBLLVM_PATH") == given


def with_package(monkeypatch: pytest.MonkeyPatch, installed: bool) -> None:
    def version(name: str) -> str:
        if not installed:
            raise PackageNotFoundError(name)
        return "2.2.0"

    monkeypatch.setattr(raytraced, "version", version)


def test_what_is_missing_is_said_with_the_remedy(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    monkeypatch.setattr(raytraced, "LLVM_PLACES", (f"{tmp_path}/libLLVM*",))
    with_package(monkeypatch, False)
    assert "pip install 'cellpilot[raytrace]'" in (missing_for_raytracing() or "")
    with pytest.raises(InputError, match="sionna-rt is not installed"):
        try_raytracing()
    with_package(monkeypatch, True)
    assert "apt-get install libllvm19" in (missing_for_raytracing() or "")
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", f"{tmp_path}/gone.so")
    assert f"DRJIT_LIBLLVM_PATH is {tmp_path}/gone.so: no such file" in (missing_for_raytracing() or "")
    library = tmp_path / "libLLVM-19.so"
    library.touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(library))
    assert missing_for_raytracing() is None
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH")
    assert missing_for_raytracing() is None


def test_looking_for_sionna_does_not_import_it() -> None:
    code = "import sys; from cellpilot.maps.sources.raytraced import missing_for_raytracing; missing_for_raytracing()"
    code += "; print('sionna' in sys.modules)"
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout == "False\n"


PLACE = {"x_m": np.array([0.0, 50.0, 100.0]), "y_m": np.array([0.0, 50.0]), "heights_m": (20.0, 40.0)}


def test_without_the_package_nothing_is_traced(monkeypatch: pytest.MonkeyPatch) -> None:
    with_package(monkeypatch, False)
    with pytest.raises(InputError, match="not possible here: the package sionna-rt is not installed"):
        raytrace_map(three_sectors(), "munich", **PLACE)


TRACER = """#!{python}
import json, sys
import numpy as np
request = json.load(open(sys.argv[3]))
open({copy!r}, "w").write(json.dumps(request))
gain = np.full((3, 2, 2, 3), 1e-12)
gain[1, 0] = 1e-10
gain[:, 0, 0, 0] = 0.0
np.savez(sys.argv[4], gain=gain, roofs_m=np.array([[0.0, 25.0, 40.0], [20.0, 0.0, 0.0]]), raised_m=np.array([25.0, 31.0, 25.0]))
"""


@pytest.fixture
def told(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    """Where a stand-in for the tracing process, which gives round gains, puts the request it was given."""
    with_package(monkeypatch, True)
    (tmp_path / "libLLVM.so").touch()
    monkeypatch.setenv("DRJIT_LIBLLVM_PATH", str(tmp_path / "libLLVM.so"))
    request = tmp_path / "told.json"
    monkeypatch.setattr(sys, "executable", program(tmp_path, TRACER.format(python=sys.executable, copy=str(request))))
    return request


def test_from_path_gain_to_a_map(told: Path) -> None:
    deployment = three_sectors(power_dbm=[40.0, 46.0, 40.0])
    rays = Rays(rays=1000, seed=7)
    radio_map = raytrace_map(deployment, "/some/town.xml", **PLACE, rays=rays, names=("a", "b", "c"))  # type: ignore[arg-type]
    # Below a roof, or on it; and where nothing arrives.
    assert blocked_cells(radio_map).tolist() == [[[1, 1, 1], [1, 0, 0]], [[0, 0, 1], [0, 0, 0]]]
    low_db = 46 - 100 - 10 * np.log10(mw(40 - 120, 40 - 120, NOISE_DBM))
    high_db = 46 - 120 - 10 * np.log10(mw(40 - 120, 40 - 120, NOISE_DBM))
    sinr_db = radio_map["sinr_db"].values
    np.testing.assert_allclose(sinr_db[0][~np.isnan(sinr_db[0])], low_db, atol=1e-5)
    np.testing.assert_allclose(sinr_db[1][~np.isnan(sinr_db[1])], high_db, atol=1e-5)
    assert radio_map["sector_height_m"].values.tolist() == [25.0, 31.0, 25.0]
    assert radio_map["sector_name"].values.tolist() == ["a", "b", "c"]
    assert (radio_map.attrs["seed"], radio_map.attrs["source"]) == (7, "ray tracing")
    assert "scene town, 1,000 rays" in radio_map.attrs["model"]


def test_the_process_is_told_the_whole_deployment(told: Path) -> None:
    antenna = [ColumnAntenna(8, 0.6, 5.0, mechanical_deg) for mechanical_deg in (0.0, 2.0, 4.0)]
    raytrace_map(three_sectors(antenna=antenna, carrier_hz=3.5e9), "munich", **PLACE, rays=Rays(reflections=5, diffuse=True))
    request = json.loads(told.read_text())
    assert (request["scene"], request["carrier_hz"], request["bandwidth_hz"]) == ("munich", 3.5e9, 10e6)
    assert (request["elements"], request["spacing_wavelengths"], request["electrical_tilt_deg"]) == (8, 0.6, 5.0)
    assert (request["reflections"], request["diffuse"], request["diffraction"], request["seed"]) == (5, True, False, 42)
    assert (request["x_m"], request["y_m"], request["heights_m"]) == ([0, 50, 100], [0, 50], [20, 40])
    assert [s["boresight_deg"] for s in request["sectors"]] == [30, 150, 270]
    assert [s["mechanical_tilt_deg"] for s in request["sectors"]] == [0, 2, 4]
    assert request["sectors"][0].items() >= {"x_m": 0.0, "y_m": 0.0, "height_m": 25.0}.items()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"carrier_hz": [2e9, 2e9, 8e8]}, "one carrier and one bandwidth"),
        ({"bandwidth_hz": [10e6, 20e6, 10e6]}, "one carrier and one bandwidth"),
        ({"antenna": [ColumnAntenna(10, 0.8, tilt_deg) for tilt_deg in (7.0, 7.0, 8.0)]}, "same column antenna"),
        ({"antenna": [ColumnAntenna(n, 0.8, 7.0) for n in (8, 10, 10)]}, "same column antenna"),
    ],
)
def test_what_one_trace_cannot_do_is_refused(told: Path, changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        raytrace_map(three_sectors(**changes), "munich", **PLACE)
    assert not told.exists()


@pytest.mark.raytrace
def test_a_trial_names_what_it_ran_on() -> None:
    assert try_raytracing().startswith("sionna-rt 2")


@pytest.mark.raytrace
def test_munich() -> None:
    """Three sectors over the Frauenkirche and its quarter: streets at 10 m, roofs above them, free sky above the towers."""
    assert missing_for_raytracing() is None
    along_m = np.arange(-280.0, 300.0, 40.0)
    shares: list[float] = []
    trace = lambda seed: raytrace_map(
        three_sectors(),
        "munich",
        x_m=along_m,
        y_m=along_m,
        heights_m=(10.0, 40.0, 120.0),
        rays=Rays(rays=200_000, reflections=2, seed=seed),
        progress=shares.append,
    )
    radio_map = trace(1)
    assert shares == sorted(shares)
    assert (len(shares), shares[-1]) == (9, 1.0)
    blocked, sinr_db = blocked_cells(radio_map), radio_map["sinr_db"].values
    assert np.isfinite(sinr_db[~blocked]).all()
    assert np.isnan(sinr_db[blocked]).all()
    assert blocked[0].mean() > 0.3
    assert blocked[1].mean() < 0.2
    assert not blocked[2].any()
    assert not (blocked[1] & ~blocked[0]).any()
    # Above the roofs the sector serves that points there, but for reflections: a mirrored or turned antenna would not.
    east_m, north_m = np.meshgrid(along_m, along_m)
    off_deg = np.degrees(np.arctan2(north_m, east_m))[..., None] - np.array([30.0, 150.0, 270.0])
    nearest = np.abs((off_deg + 180) % 360 - 180).argmin(axis=-1)
    assert (radio_map["serving_sector"].values[1] == nearest)[~blocked[1]].mean() > 0.8
    # The compiler adds up rays in whatever order its threads end: the last bits differ.
    again, other = trace(1), trace(2)
    assert (blocked_cells(again) == blocked).all()
    np.testing.assert_allclose(again["sinr_db"].values, sinr_db, atol=1e-3)
    assert np.nanmean(np.abs(other["sinr_db"].values - sinr_db)) > 0.1


def test_the_weights_of_the_traced_column_point_where_ours_does() -> None:
    column, zenith_deg = ColumnAntenna(8, 0.7, 6.0), np.linspace(60.0, 120.0, 61)
    # Elements from the top down, seen from below: a wave that goes down reaches the lower ones ahead of the upper ones.
    ahead = -2j * np.pi * 0.7 * np.arange(8)[:, None] * np.cos(np.radians(zenith_deg))
    factor_db = 20 * np.log10(np.abs(column_weights(8, 0.7, 6.0) @ np.exp(ahead)))
    expected_db = column.gain_dbi(0.0, zenith_deg) - element_gain_dbi(0.0, zenith_deg)
    np.testing.assert_allclose(np.maximum(factor_db, -40.0), expected_db, rtol=0, atol=1e-6)
