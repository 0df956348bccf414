"""The part of ray tracing that runs in a process of its own: `python -m cellpilot.maps.sources.raytrace_worker REQUEST RESULT`.

A wrong LLVM library ends the whole process, and Sionna brings a just-in-time compiler with threads of its own; neither must
reach the program that asks. REQUEST is a JSON file, RESULT an NPZ file; lines `progress SHARE` on standard output tell how
far it is.
"""

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

ABOVE_EVERYTHING_M = 10_000.0


def main(request_file: str, result_file: str) -> None:
    """Trace what the request asks for."""
    import mitsuba as mi
    import sionna.rt as rt

    request: dict[str, Any] = json.loads(Path(request_file).read_text())
    scene = rt.load_scene(_scene_file(rt, request["scene"]), merge_shapes=True)
    scene.frequency, scene.bandwidth = request["carrier_hz"], request["bandwidth_hz"]
    scene.tx_array = rt.PlanarArray(
        num_rows=request["elements"],
        num_cols=1,
        vertical_spacing=request["spacing_wavelengths"],
        horizontal_spacing=0.5,
        pattern="tr38901",
        polarization="V",
    )
    x_m, y_m, heights_m = (np.array(request[name], dtype=np.float64) for name in ("x_m", "y_m", "heights_m"))
    roofs_m = roof_heights_m(mi, scene, *np.meshgrid(x_m, y_m))
    sectors = request["sectors"]
    masts_m = roof_heights_m(mi, scene, np.array([s["x_m"] for s in sectors]), np.array([s["y_m"] for s in sectors]))
    tall_m = np.array([s["height_m"] for s in sectors])
    # A mast that would stand inside a building stands on its roof.
    raised_m = np.where(tall_m < masts_m + request["above_roof_m"], masts_m + request["above_roof_m"], tall_m)
    weights = column_weights(request["elements"], request["spacing_wavelengths"], request["electrical_tilt_deg"])
    gain = np.empty((len(sectors), len(heights_m), len(y_m), len(x_m)))
    step_m = (float(x_m[1] - x_m[0]), float(y_m[1] - y_m[0]))
    plane = {
        "size": [step_m[0] * len(x_m), step_m[1] * len(y_m)],
        "orientation": [0.0, 0.0, 0.0],
        "cell_size": list(step_m),
        "samples_per_tx": request["rays"],
        "max_depth": request["reflections"],
        "diffuse_reflection": request["diffuse"],
        "diffraction": request["diffraction"],
        "seed": request["seed"],
    }
    solver = rt.RadioMapSolver()
    for i, sector in enumerate(sectors):
        # One transmitter at a time bounds the memory and lets progress be told.
        yaw, pitch = np.radians(sector["boresight_deg"]), np.radians(sector["mechanical_tilt_deg"])
        position = [sector["x_m"], sector["y_m"], float(raised_m[i])]
        scene.add(rt.Transmitter(f"sector{i}", position=position, orientation=[float(yaw), float(pitch), 0.0]))
        for iz, height_m in enumerate(heights_m):
            centre = [float(x_m.mean()), float(y_m.mean()), float(height_m)]
            # The solver changes the arrays it is given: they are made anew for each call.
            precoding = tuple(mi.TensorXf(part.astype(np.float32)) for part in (weights.real, weights.imag))
            gain[i, iz] = np.array(solver(scene, center=centre, precoding_vec=precoding, **plane).path_gain)[0]
            sys.stdout.write(f"progress {(i * len(heights_m) + iz + 1) / (len(sectors) * len(heights_m)):.4f}\n")
            sys.stdout.flush()
        scene.remove(f"sector{i}")
    np.savez(result_file, gain=gain, roofs_m=roofs_m, raised_m=raised_m)


def column_weights(elements: int, spacing_wavelengths: float, tilt_deg: float) -> NDArray[np.complex128]:
    """Weights of the elements of a column, from the top down, for an electrical downtilt.

    Source: as `ColumnAntenna`, TR 36.873 clause 7.1.
    """
    phase = 2.0 * np.pi * spacing_wavelengths * np.arange(elements) * np.cos(np.radians(90.0 + tilt_deg))
    return np.asarray(np.exp(1j * phase) / np.sqrt(elements))


def roof_heights_m(mi: Any, scene: Any, x_m: NDArray[np.float64], y_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Height of what a ray from straight above hits first, in the shape of the places; 0 where it hits nothing."""
    x, y = (mi.Float(values.ravel().astype(np.float32)) for values in (x_m, y_m))
    ray = mi.Ray3f(mi.Point3f(x, y, mi.Float(ABOVE_EVERYTHING_M)), mi.Vector3f(0.0, 0.0, -1.0))
    found = scene.mi_scene.ray_intersect_preliminary(ray, coherent=True)
    hit = np.array(found.is_valid())
    return np.where(hit, ABOVE_EVERYTHING_M - np.array(found.t), 0.0).reshape(x_m.shape)


def _scene_file(rt: Any, name: str) -> Any:
    if hasattr(rt.scene, name):
        return getattr(rt.scene, name)
    if not Path(name).is_file():
        known = ", ".join(sorted(each for each in dir(rt.scene) if str(getattr(rt.scene, each)).endswith(".xml")))
        raise SystemExit(f"no scene and no file {name!r}; expected a Mitsuba XML file or one of {known}")
    return name


if __name__ == "__main__":
    main(*sys.argv[1:])
