"""Maps from ray tracing with Sionna RT (extra `raytrace`), in a process of its own."""

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from glob import glob
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.geodesy import Anchor
from cellpilot.maps.reasons import INSIDE_BUILDING, NO_RAY
from cellpilot.maps.schema import RadioMap, make_map
from cellpilot.maps.sectors import NOISE_FIGURE, sectors_of
from cellpilot.radio import ColumnAntenna, Deployment, Interference, hexagonal_deployment
from cellpilot.units import to_db

LLVM_VARIABLE = "DRJIT_LIBLLVM_PATH"
LLVM_PLACES = (
    "/usr/lib/*/libLLVM-19.so",
    "/usr/lib/llvm-19/lib/libLLVM*.so*",
    "/usr/lib/*/libLLVM.so.19*",
    "/usr/lib/*/libLLVM.so.2*",
    "/usr/lib/*/libLLVM-2*.so",
)
"""Where Debian's libllvm19 and newer ones lie. Versions 15 and 16 end the process, 14 is refused."""


@dataclass(frozen=True)
class Rays:
    """How rays are traced."""

    rays: int = 1_000_000  # of each sector at each height
    reflections: int = 3
    diffuse: bool = False
    diffraction: bool = False
    seed: int = 42
    above_roof_m: float = 3.0  # of an antenna whose mast would stand inside a building


def missing_for_raytracing() -> str | None:
    """What is missing for ray tracing and how to get it, in one sentence; None if all is there, as far as can be seen.

    Sionna is not imported for it: with a wrong LLVM that ends the process.
    """
    try:
        version("sionna-rt")
    except PackageNotFoundError:
        return "the package sionna-rt is not installed: pip install 'cellpilot[raytrace]'"
    library = _llvm()
    if library is None:
        return f"no LLVM library of version 19 or newer: apt-get install libllvm19, or set {LLVM_VARIABLE} to libLLVM.so"
    if not Path(library).is_file():
        return f"{LLVM_VARIABLE} is {library}: no such file; set it to libLLVM.so of version 19 or newer, or unset it"
    return None


def try_raytracing() -> str:
    """What Sionna RT runs on here, after one sector was traced in a small box; `InputError` if that fails."""
    missing = missing_for_raytracing()
    if missing:
        raise InputError(missing)
    deployment, axis_m = hexagonal_deployment(rings=0, boresights_deg=(0.0,)), np.array([-1.0, 1.0])
    request = _request(deployment, "box", axis_m, axis_m, (1.5,), Rays(rays=1_000, reflections=1))
    with tempfile.TemporaryDirectory() as folder:
        _run(request, Path(folder), lambda share: None)
    return f"sionna-rt {version('sionna-rt')} on {_llvm()}"


def raytrace_map(
    deployment: Deployment,
    scene: str,
    *,
    x_m: FloatArray,
    y_m: FloatArray,
    heights_m: Sequence[float],
    rays: Rays = Rays(),
    names: Sequence[str] | None = None,
    anchor: Anchor | None = None,
    progress: Callable[[float], None] = lambda share: None,
) -> RadioMap:
    """The RadioMap of a deployment in a scene of Sionna RT ("munich", "etoile", or a Mitsuba XML file), at cell centres [m].

    `anchor` says where on Earth x = y = 0 of the scene lies. A cell's SINR follows from its mean path gain over the cell's
    area. Cells below the roof of a building, and those that no ray reaches, are blocked, each for its own reason. All sectors
    need one carrier and one column antenna up to mechanical tilt. `InputError` for anything else, for what is missing, and
    with the last line of the tracing process should that fail.

    The same seed gives the same rays; sums on several threads differ in the last bits, by some 1e-5 dB.

    Source: path gain as defined for radio maps of Sionna RT (mean of |h|^2 over a cell); antenna TR 38.901 Table 7.3-1.
    """
    missing = missing_for_raytracing()
    if missing:
        raise InputError(f"ray tracing is not possible here: {missing}")
    request = _request(deployment, scene, x_m, y_m, heights_m, rays)
    with tempfile.TemporaryDirectory() as folder:
        result = _run(request, Path(folder), progress)
        gain, roofs_m, raised_m = (result[name] for name in ("gain", "roofs_m", "raised_m"))
    z_m = np.asarray(heights_m, dtype=np.float64)
    with np.errstate(divide="ignore"):
        power_dbm = deployment.power_dbm[:, None, None, None] + to_db(gain)
    radio_map = map_of_powers(deployment, power_dbm, x_m, y_m, z_m, roofs_m[None] >= z_m[:, None, None], names, raised_m, anchor)
    radio_map.attrs |= {
        "source": "ray tracing",
        "model": f"Sionna RT, scene {Path(scene).stem}, {rays.rays:,} rays a sector, {rays.reflections} reflections",
        "seed": rays.seed,
        "rays": json.dumps(asdict(rays), sort_keys=True),
    }
    return radio_map


def map_of_powers(
    deployment: Deployment,
    power_dbm: FloatArray,
    x_m: FloatArray,
    y_m: FloatArray,
    z_m: FloatArray,
    inside: NDArray[np.bool_],
    names: Sequence[str] | None,
    height_m: FloatArray,
    anchor: Anchor | None = None,
) -> RadioMap:
    """The map of received powers `[sector, z, y, x]` [dBm, -inf where nothing arrives].

    Cells that are `inside [z, y, x]` a building, and those in which nothing arrives, are blocked.
    """
    sectors = sectors_of(deployment, names) | {"sector_height_m": height_m}
    return map_of_levels(deployment.interference, power_dbm, x_m, y_m, z_m, sectors, deployment.noise_figure_db, inside, anchor)


def map_of_levels(
    interference: Interference,
    power_dbm: FloatArray,
    x_m: FloatArray,
    y_m: FloatArray,
    z_m: FloatArray,
    sectors: Mapping[str, NDArray[np.generic]],
    noise_figure_db: float,
    inside: NDArray[np.bool_] | bool = False,
    anchor: Anchor | None = None,
) -> RadioMap:
    """As `map_of_powers`, of sectors of which no more is known than their `interference` and the coordinates `sectors`."""
    shape = power_dbm.shape[1:]
    serving, best_dbm, sinr_db = (values.reshape(shape) for values in interference.serve(power_dbm.reshape(len(power_dbm), -1)))
    unknown = np.isneginf(best_dbm) | inside
    rsrp_dbm = power_dbm - interference.subcarriers_db[:, None, None, None]
    return make_map(
        np.where(unknown, np.nan, sinr_db),
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        source="ray tracing",
        sinr_std_db=np.where(unknown, np.nan, 0.0),
        blocked_reason=np.where(inside, 1, 2 * np.isneginf(best_dbm)),
        reasons=(INSIDE_BUILDING, NO_RAY),
        optional={
            "serving_sector": np.where(unknown, -1, serving),
            "rsrp_dbm": np.where(np.isneginf(rsrp_dbm), np.nan, rsrp_dbm),
        },
        sectors=sectors,
        anchor=anchor,
        attributes={NOISE_FIGURE: noise_figure_db},
    )


def _request(
    deployment: Deployment, scene: str, x_m: FloatArray, y_m: FloatArray, heights_m: Sequence[float], rays: Rays
) -> dict[str, Any]:
    columns = [antenna for antenna in deployment.antenna if isinstance(antenna, ColumnAntenna)]
    antennas = {(column.n_vertical, column.spacing_wavelengths, column.electrical_tilt_deg) for column in columns}
    if len(antennas) != 1 or len(columns) < deployment.n_sectors:
        raise InputError("ray tracing needs the same column antenna, with the same electrical tilt, in all sectors")
    if len(np.unique(deployment.carrier_hz)) > 1 or len(np.unique(deployment.bandwidth_hz)) > 1:
        raise InputError("ray tracing needs one carrier and one bandwidth in all sectors: trace each carrier alone")
    elements, spacing, tilt_deg = antennas.pop()
    sectors = [
        {
            "x_m": float(deployment.x_m[i]),
            "y_m": float(deployment.y_m[i]),
            "height_m": float(deployment.height_m[i]),
            "boresight_deg": float(deployment.boresight_deg[i]),
            "mechanical_tilt_deg": float(column.mechanical_tilt_deg),
        }
        for i, column in enumerate(columns)
    ]
    return {
        "scene": scene,
        "x_m": x_m.tolist(),
        "y_m": y_m.tolist(),
        "heights_m": list(heights_m),
        "carrier_hz": float(deployment.carrier_hz[0]),
        "bandwidth_hz": float(deployment.bandwidth_hz[0]),
        "elements": elements,
        "spacing_wavelengths": spacing,
        "electrical_tilt_deg": tilt_deg,
        "sectors": sectors,
        **asdict(rays),
    }


def _run(request: dict[str, Any], folder: Path, progress: Callable[[float], None]) -> dict[str, FloatArray]:
    """Let the worker trace and read its result; `InputError` with what it said last if it fails or is ended by a signal."""
    question, answer = folder / "request.json", folder / "result.npz"
    question.write_text(json.dumps(request))
    complaints, library = folder / "stderr", str(_llvm())
    command = [sys.executable, "-m", "cellpilot.maps.sources.raytrace_worker", str(question), str(answer)]
    environment = os.environ | {LLVM_VARIABLE: library}
    with (
        complaints.open("w") as errors,
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, env=environment) as worker,
    ):
        assert worker.stdout is not None
        for line in worker.stdout:
            if line.startswith("progress "):
                progress(float(line.split()[1]))
    if worker.returncode < 0:
        raise InputError(
            f"ray tracing was ended by signal {-worker.returncode}: is {library} LLVM of version 19 or newer?"
            f" (apt-get install libllvm19, or set {LLVM_VARIABLE})"
        )
    if worker.returncode or not answer.exists():
        said = [line for line in complaints.read_text(errors="replace").splitlines() if line.strip()]
        raise InputError(f"ray tracing failed: {said[-1] if said else f'exit code {worker.returncode}'} (LLVM: {library})")
    with np.load(answer) as result:
        return {name: result[name] for name in result.files}


def _llvm() -> str | None:
    if os.environ.get(LLVM_VARIABLE):
        return os.environ[LLVM_VARIABLE]
    return next((path for pattern in LLVM_PLACES for path in sorted(glob(pattern))), None)
