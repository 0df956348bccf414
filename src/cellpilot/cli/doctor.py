"""`cellpilot doctor`: what is installed, and whether the parts work together."""

import os
import platform
from collections.abc import Callable, Iterable, Sequence

from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.errors import InputError
from cellpilot.learn.algorithms.table import OWN
from cellpilot.maps.files import map_sources
from cellpilot.maps.sources.raytraced import try_raytracing
from cellpilot.provenance import versions
from cellpilot.scenario import LEARNERS, SHIPPED, Settings
from cellpilot.service.exporting import OWN_EXPORTS, exports

WITH_POLICY = ("thesis-2d", "thesis-2d-noise", "thesis-3d")
"""Scenarios that ship with a trained policy."""


class DoctorOptions(Settings):
    """Options of `doctor`."""

    verbose: bool = Field(False, description="also list the shipped scenarios")


def main(arguments: Sequence[str]) -> int:
    """Verb `doctor`; exit code 1 if something does not work."""
    options = parse(DoctorOptions, arguments, "cellpilot doctor", "Check the installation.")
    out.print(f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores")
    for name, version in versions().items():
        out.print(f"  {name:<10} {version}")
    checks: dict[str, Callable[[], str]] = {
        "JAX": _jax,
        "radio model": _radio,
        "map files": _files,
        "shipped policies": _policies,
        "learners of other packages": lambda: _names(set(LEARNERS) - set(OWN)),
        "map sources of other packages": lambda: _names(map_sources()),
        "exports of other packages": lambda: _names(set(exports()) - set(OWN_EXPORTS)),
    }
    failed = 0
    for name, check in checks.items():
        try:
            out.print(f"ok    {name}: {check()}")
        except Exception as error:
            failed += 1
            out.print(f"FAIL  {name}: {type(error).__name__}: {error}")
    # An extra that nobody asked for is no failure.
    try:
        out.print(f"ok    ray tracing: {try_raytracing()}")
    except InputError as error:
        out.print(f"--    ray tracing: {error}")
    if options.verbose:
        for path in sorted(SHIPPED.glob("*.toml")):
            out.print(f"  scenario {path.stem}")
    return 1 if failed else 0


def _jax() -> str:
    import jax

    total = jax.jit(lambda x: x.sum())(jax.numpy.ones(3))
    return f"devices {', '.join(map(str, jax.devices()))}, sum of three ones = {float(total):g}"


def _radio() -> str:
    from cellpilot.experiment import build_map
    from cellpilot.scenario import SimulatedMap

    sinr_db = build_map(SimulatedMap(bin_m=100.0, points_per_side=2))["sinr_db"]
    return f"{sinr_db.size} cells simulated, {float(sinr_db.min()):.1f} to {float(sinr_db.max()):.1f} dB"


def _files() -> str:
    import tempfile
    from pathlib import Path

    from cellpilot.experiment import build_map
    from cellpilot.maps import load_map, save_map
    from cellpilot.scenario import SimulatedMap

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "map.nc"
        radio_map = build_map(SimulatedMap(bin_m=200.0, points_per_side=1))
        save_map(radio_map, path)
        if not load_map(path).equals(radio_map):
            raise ValueError("a map written and read back differs")
    return "written and read back equal"


def _policies() -> str:
    from cellpilot.policies import load_parameters

    for name in WITH_POLICY:
        load_parameters(SHIPPED / f"{name}.safetensors")
    return ", ".join(WITH_POLICY)


def _names(names: Iterable[str]) -> str:
    return ", ".join(sorted(names)) or "none"
