"""Radio maps that Sionna RT has computed elsewhere and a person saved with `numpy.savez`, one file a height.

```python
np.savez("30m.npz", path_gain=radio_map.path_gain.numpy(), cell_centers=radio_map.cell_centers.numpy())
```

`path_gain` (or `rss` [W], or `sinr`) is `[transmitter, y, x]` and linear, `cell_centers` is `[y, x, 3]` [m]; the names are
those of Sionna's `PlanarRadioMap`. Without a SINR of its own the map follows from the path gain and what `Receiver` says of
the network.
"""

from collections.abc import Sequence
from dataclasses import dataclass, fields
from itertools import pairwise
from math import prod
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np

from cellpilot.array_types import FloatArray
from cellpilot.errors import InputError
from cellpilot.maps.limits import check_size
from cellpilot.maps.reasons import NO_RAY
from cellpilot.maps.schema import RadioMap, make_map
from cellpilot.maps.sources.raytraced import map_of_levels
from cellpilot.maps.text_table import UNREADABLE
from cellpilot.radio import Interference
from cellpilot.radio.settings import HEXAGONAL
from cellpilot.units import to_db

SUFFIX = ".npz"
CENTRES = "cell_centers"
MOST_BYTES = 1_000_000_000
"""Of one array."""
LEVELS = ("sinr", "rss", "path_gain")
"""What a file may hold, the more telling first."""


@dataclass(frozen=True)
class Receiver:
    """The network behind saved path gains, the same for all transmitters."""

    power_dbm: float = 44.0
    carrier_hz: float = 3.5e9
    bandwidth_hz: float = HEXAGONAL.bandwidth_hz
    noise_figure_db: float = HEXAGONAL.noise_figure_db
    load: float = HEXAGONAL.load

    def words(self) -> str:
        """One line that says all of it."""
        return (
            f"taken for all transmitters: {self.power_dbm:g} dBm, {self.carrier_hz / 1e6:g} MHz,"
            f" {self.bandwidth_hz / 1e6:g} MHz wide, load {self.load:g}, noise figure {self.noise_figure_db:g} dB"
        )


def read_sionna(paths: Sequence[str | Path], receiver: Receiver = Receiver()) -> RadioMap:
    """The RadioMap of saved Sionna maps, one horizontal plane a file, all with the same cells and transmitters.

    From `sinr` the best transmitter of each cell counts as it is; from `rss` or `path_gain` SINR and RSRP of every
    transmitter follow with the `receiver`, which the map names. Cells that nothing reaches are blocked. `InputError` naming
    the file and the array for anything missing, of another shape, negative, not a horizontal grid, or different between
    files, and for a receiver that the arrays leave without effect.
    """
    planes = sorted((_read(Path(path)) for path in paths), key=lambda plane: plane.z_m)
    for first, other in pairwise(planes):
        if other.kind != first.kind or other.values.shape != first.values.shape or not np.array_equal(other.xy_m, first.xy_m):
            raise InputError(
                f"{other.path}: array {other.kind!r} {other.values.shape}: other cells or array than in {first.path}"
            )
        if other.z_m == first.z_m:
            raise InputError(f"{other.path}: array {CENTRES!r}: the same height {other.z_m:g} m as {first.path}")
    kind, (x_m, y_m) = planes[0].kind, (planes[0].xy_m[0, :, 0], planes[0].xy_m[:, 0, 1])
    z_m, level = np.array([plane.z_m for plane in planes]), np.stack([plane.values for plane in planes], axis=1)
    names = np.array([f"transmitter {number}" for number in range(len(level))])
    idle = {"sinr": tuple(f.name for f in fields(Receiver)), "rss": ("power_dbm",), "path_gain": ()}[kind]
    for name in idle:
        if getattr(receiver, name) != getattr(Receiver, name):
            raise InputError(f"{planes[0].path}: array {kind!r} leaves {name} of the receiver without effect: leave it out")
    model = f"Sionna RT, saved {kind}: {', '.join(plane.path.name for plane in planes)}"
    if kind == "sinr":
        sinr_db = to_db(level.max(axis=0))
        unknown = np.isneginf(sinr_db)
        return make_map(
            np.where(unknown, np.nan, sinr_db),
            x_m=x_m,
            y_m=y_m,
            z_m=z_m,
            sinr_std_db=np.where(unknown, np.nan, 0.0),
            blocked_reason=unknown,
            reasons=(NO_RAY,),
            optional={"serving_sector": np.where(unknown, -1, level.argmax(axis=0))},
            sectors={"sector_name": names},
            source="ray tracing",
            model=model,
        )
    power_dbm = to_db(level) + (30.0 if kind == "rss" else receiver.power_dbm)
    alike = {name: np.full(len(level), getattr(receiver, name)) for name in ("power_dbm", "carrier_hz", "bandwidth_hz", "load")}
    interference = Interference.of(alike["carrier_hz"], alike["bandwidth_hz"], alike["load"], receiver.noise_figure_db)
    sectors = {"sector_name": names} | {f"sector_{name}": values for name, values in alike.items()}
    if kind == "rss":
        del sectors["sector_power_dbm"]
    radio_map = map_of_levels(interference, power_dbm, x_m, y_m, z_m, sectors, receiver.noise_figure_db)
    radio_map.attrs |= {"model": model, "receiver": receiver.words()}
    return radio_map


@dataclass(frozen=True)
class _Plane:
    path: Path
    kind: str
    values: FloatArray  # [transmitter, y, x] linear
    xy_m: FloatArray  # [y, x, 2]
    z_m: float


def _check_unpacked(path: Path, file: Any, names: list[str]) -> None:
    """`InputError` if the arrays unpack to more than is read, as the directory of the archive and their headers say."""
    for name in names:
        entry = file.zip.getinfo(f"{name}.npy")
        with file.zip.open(entry) as packed:
            version = np.lib.format.read_magic(packed)
            header = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
            shape, _, dtype = header(packed)
        n_bytes = max(entry.file_size, dtype.itemsize * prod(shape))
        if n_bytes > MOST_BYTES:
            raise InputError(
                f"{path}: array {name!r} unpacks to {n_bytes / 1e9:.3g} GB; at most {MOST_BYTES / 1e9:g} GB are read"
            )


def _read(path: Path) -> _Plane:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            wanted = [name for name in (CENTRES, *LEVELS) if name in file.files]
            _check_unpacked(path, file, wanted)
            read = {name: file[name] for name in wanted}
            for name, array in read.items():
                if array.dtype.kind not in "fiu":
                    raise InputError(f"{path}: array {name!r} is of type {array.dtype}; expected real numbers")
            arrays = {name: np.asarray(array, dtype=np.float64) for name, array in read.items()}
            found = ", ".join(file.files) or "none"
    except InputError:
        raise
    except (
        *UNREADABLE,
        ValueError,
        TypeError,
        AttributeError,
        LookupError,
        MemoryError,
        NotImplementedError,
        BadZipFile,
    ) as error:
        raise InputError(
            f"{path}: cannot be read as arrays saved with numpy.savez ({str(error) or type(error).__name__})"
        ) from None
    kind = next((name for name in LEVELS if name in arrays), None)
    if kind is None or CENTRES not in arrays:
        raise InputError(f"{path}: arrays {found}; expected {CENTRES!r} and one of {', '.join(map(repr, LEVELS))}")
    values, centres_m = arrays[kind], arrays[CENTRES]
    if values.ndim == 2:
        values = values[None]
    if not values.size or values.ndim != 3 or centres_m.shape != (*values.shape[1:], 3):
        raise InputError(
            f"{path}: array {kind!r} has shape {values.shape} and {CENTRES!r} {centres_m.shape};"
            " expected (transmitters, y, x) and (y, x, 3)"
        )
    check_size(values.shape[1:], str(path))
    if not ((values >= 0) & (values < np.inf)).all():
        raise InputError(f"{path}: array {kind!r} has values below 0, infinite or NaN; expected linear values, not dB")
    x_m, y_m, z_m = centres_m[0, :, 0].round(3), centres_m[:, 0, 1].round(3), centres_m[0, 0, 2].round(3)
    flat = np.stack([*np.broadcast_arrays(x_m, y_m[:, None], z_m)], axis=-1)
    rising = (np.diff(x_m) > 0).all() and (np.diff(y_m) > 0).all()
    if not rising or not np.allclose(centres_m, flat, atol=2e-3):
        raise InputError(
            f"{path}: array {CENTRES!r} is no horizontal grid along rising x and y; expected a map with orientation 0"
        )
    return _Plane(path, kind, values, flat[..., :2], float(z_m))
