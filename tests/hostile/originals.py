"""One sound file of every kind that cellpilot reads, small, and the command that reads each."""

import gzip
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from cellpilot.cli.main import main
from cellpilot.maps import load_map, make_map, save_map
from cellpilot.maps.geodesy import Anchor
from cellpilot.policies import load_parameters
from cellpilot.radio.antenna_file import AntennaFile, write_antenna
from cellpilot.runs import load_evaluation, map_digest, policy_digest
from cellpilot.storage import load_netcdf

SCENARIO = """\
name = "tiny"

[map]
heights_m = [30.0]
bin_m = 100.0
points_per_side = 2

[task]
threshold_db = 5.0

[learner]
episodes = 12
replay_start = 100
replay_capacity = 2000
updates_per_episode = 2

[evaluation]
n_sampled = 40
"""


@dataclass(frozen=True)
class Kind:
    """A kind of file: its place below the folder of originals, the command on it, and what its content is worth.

    `{file}` stands for the file, `{run}` for the run folder that it lies in. `content` gives the digest of what is read, where
    cellpilot wrote a checksum along.
    """

    file: str
    command: tuple[str, ...]
    content: Callable[[Path], str] | None = None


def _map(path: Path) -> str:
    return map_digest(load_map(path))


INFO = ("map", "info", "{file}")
EVALUATE = ("evaluate", "{run}", "--json")
KINDS = {
    "NetCDF map": Kind("m.nc", INFO, _map),
    "Zarr map": Kind("m.zarr", INFO, _map),
    "GeoTIFF map": Kind("m.tif", INFO, _map),
    "CSV map": Kind("m.csv", INFO, _map),
    "foreign CSV map": Kind("foreign.csv", INFO),
    "foreign NetCDF map": Kind("foreign.nc", INFO),
    "log": Kind("log_30m.csv", ("map", "import", "{file}", "--altitude", "30", "--bin-m", "50", "--out", "out.nc")),
    "compressed log": Kind("log_40m.csv.gz", ("map", "import", "{file}", "--altitude", "30", "--bin-m", "50", "--out", "out.nc")),
    "site list": Kind(
        "sites.csv", ("map", "simulate", "quick", "--map.sites", "{file}", "--map.points-per-side", "3", "--out", "out.nc")
    ),
    "antenna": Kind("antenna.msi", ("map", "antenna", "{file}", "--out", "out.png")),
    "Sionna map": Kind("sinr.npz", ("map", "import", "{file}", "--out", "out.nc")),
    "scenario": Kind("tiny.toml", ("map", "simulate", "{file}", "--out", "out.nc")),
    "run.json": Kind("run/run.json", EVALUATE),
    "scenario of a run": Kind("run/scenario.toml", EVALUATE),
    "map of a run": Kind("run/map.nc", EVALUATE, _map),
    "policy": Kind("run/policy.safetensors", EVALUATE, lambda path: policy_digest(load_parameters(path))),
    "policy alone": Kind(
        "policy.safetensors", ("export", "{file}", "--onnx", "out.onnx"), lambda path: policy_digest(load_parameters(path))
    ),
    "state": Kind("run/state.safetensors", ("train", "--resume", "{run}")),
    "evaluation": Kind("run/eval.nc", ("report", "{run}"), lambda path: map_digest(load_evaluation(path.parent))),
    "learning curve": Kind("run/train.nc", ("report", "{run}"), lambda path: map_digest(load_netcdf(path, "a curve"))),
}
"""Every kind of file by name."""


def make_originals(folder: Path) -> None:
    """Write one of each kind into the folder."""
    folder.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(1)
    metres = np.arange(6) * 50.0 - 125.0
    radio_map = make_map(
        rng.normal(5.0, 6.0, (2, 6, 6)).astype(np.float32),
        x_m=metres,
        y_m=metres,
        z_m=[30.0, 60.0],
        source="simulation",
        sinr_std_db=0.5,
        count=rng.integers(1, 9, (2, 6, 6)),
        optional={"serving_sector": rng.integers(0, 3, (2, 6, 6))},
        sectors={
            "sector_name": np.array(["north", "west", "süd"]),
            "sector_x_m": np.zeros(3),
        },
        anchor=Anchor(3.0, 101.0, 0.0),
    )
    for name in ("m.nc", "m.zarr", "m.tif", "m.csv"):
        save_map(radio_map, folder / name)
    radio_map.to_netcdf(folder / "foreign.nc", engine="h5netcdf")
    cells = [f"{x},{y},{z},{rng.normal(5, 6):.3f}" for z in (30, 60) for y in metres for x in metres]
    (folder / "foreign.csv").write_text("\n".join(["x_m,y_m,z_m,sinr_db", *cells]) + "\n", encoding="utf-8")
    samples = [
        f"2024.03.01_12.{i // 60:02}.{i % 60:02},{101 + rng.uniform(0, 3e-3):.7f},{3 + rng.uniform(0, 3e-3):.7f},4G,"
        f"{rng.normal(5, 6):.2f},{rng.normal(-90, 6):.1f}"
        for i in range(300)
    ]
    log = "\n".join(["Timestamp,Longitude,Latitude,NetworkMode,SNR,RSRP", *samples]) + "\n"
    (folder / "log_30m.csv").write_text(log, encoding="utf-8")
    (folder / "log_40m.csv.gz").write_bytes(gzip.compress(log.encode(), mtime=0))
    angle_deg = (np.arange(360) + 180) % 360 - 180.0
    horizontal_db, vertical_db = (np.minimum(12 * (angle_deg / width_deg) ** 2, 30.0) for width_deg in (65.0, 10.0))
    header = {"NAME": "column", "FREQUENCY": "1800", "ELECTRICAL_TILT": "6"}
    write_antenna(AntennaFile(header, 17.0, 1.8e9, 6.0, horizontal_db, np.roll(vertical_db, 6)), folder / "antenna.msi")
    _call("map", "sites", "quick", "--out", str(folder / "sites.csv"))
    centres_m = np.stack(np.meshgrid(metres, metres, [30.0], indexing="ij"), -1)[:, :, 0].transpose(1, 0, 2)
    np.savez(folder / "sinr.npz", sinr=10 ** rng.normal(0.5, 0.6, (2, 6, 6)), cell_centers=centres_m)
    (folder / "tiny.toml").write_text(SCENARIO, encoding="utf-8")
    _call("run", str(folder / "tiny.toml"), "--out", str(folder / "run"))
    shutil.copy(folder / "run" / "policy.safetensors", folder / "policy.safetensors")


def _call(*arguments: str) -> None:
    if code := main(list(arguments)):
        raise RuntimeError(f"cellpilot {' '.join(arguments)} ended with {code}")
