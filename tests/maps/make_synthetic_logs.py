"""Write the two synthetic drive-test logs that the package ships as examples: `python make_synthetic_logs.py [folder]`.

Everything in them is invented: a place in the open sea near 0.01 N, 0.01 E, a smooth SINR field of a few plane waves
and a slope, a drone that hovers at take-off and then flies arcs about 100 m apart. The form is that of a sparse
drive-test export with fewer columns: SINR and RSRP on separate lines, missing values, a note of the export at the end.
"""

import csv
import io
import sys
from pathlib import Path

import numpy as np

from cellpilot.maps import Anchor, to_degrees

TAKE_OFF = Anchor(0.01, 0.01)
HEIGHTS_M = (30, 50)
SEED = 20240
ARC_RADII_M = (90, 190, 290, 390, 490)
STEP_M = 11.0
HOVER_SAMPLES = 110
COLUMNS = (
    "Time",
    "Latitude",
    "Longitude",
    "Cell identification",
    "Physical cell identity (LTE detected) - 1",
    "RSRP (LTE detected) - 1",
    "Physical cell identity (LTE pcell)",
    "RSRP (LTE pcell)",
    "RSRQ (LTE pcell)",
    "RS SNR",
)


def field_db(x_m: np.ndarray, y_m: np.ndarray, height_m: float) -> np.ndarray:
    """The made-up SINR [dB]: higher near take-off, wavy over some hundred metres, 0.12 dB less per metre of height."""
    waves = 4.0 * np.sin(x_m / 85 + 0.4) * np.cos(y_m / 110) + 2.5 * np.cos((x_m - 2 * y_m) / 190 + height_m / 40)
    return 4.5 - np.hypot(x_m, y_m) / 75 - 0.12 * (height_m - 30) + waves


def track_m() -> np.ndarray:
    """Places `[n, 2]` of the flight [m]: half circles flown to and fro, joined by their radii."""
    places = []
    for number, radius_m in enumerate(ARC_RADII_M):
        angle = np.linspace(0, np.pi, int(np.pi * radius_m / STEP_M))
        angle = angle[::-1] if number % 2 else angle
        places.append(radius_m * np.stack([np.cos(angle), np.sin(angle)], axis=-1))
    return np.concatenate(places)


def log_text(height_m: int) -> str:
    """One log as text."""
    rng = np.random.default_rng([SEED, height_m])
    hover_m = rng.normal(0, 2.0, (HOVER_SAMPLES, 2))
    places_m = np.concatenate([hover_m, track_m() + rng.normal(0, 2.0, track_m().shape)])
    sinr_db = field_db(places_m[:, 0], places_m[:, 1], height_m) + rng.normal(0, 1.2, len(places_m))
    latitude_deg, longitude_deg = to_degrees(places_m[:, 0], places_m[:, 1], TAKE_OFF)
    text = io.StringIO()
    writer = csv.DictWriter(text, COLUMNS, restval="", lineterminator="\n")
    writer.writeheader()
    for number, value_db in enumerate(sinr_db):
        seconds = 36000 + 1.3 * number
        base = {"Time": f"{int(seconds // 3600):2d}:{int(seconds // 60 % 60):02d}:{seconds % 60:06.3f}"}
        if number > 1:  # the first fix takes a moment
            base |= {"Latitude": f"{latitude_deg[number]:.6f}", "Longitude": f"{longitude_deg[number]:.6f}"}
        if number % 40 == 0:
            writer.writerow(base | {"Cell identification": 1001})
        rsrp = f"{-78 - np.hypot(*places_m[number]) / 60 + rng.normal(0, 2):.1f}"
        if number % 5 == 0:
            detected = {COLUMNS[4]: 7, COLUMNS[5]: rsrp}
            writer.writerow(base | detected)
        if number % 4 != 3:
            writer.writerow(base | {COLUMNS[6]: 7, COLUMNS[7]: rsrp, COLUMNS[8]: "-9.0"})
        writer.writerow(base | {"RS SNR": f"{round(2 * value_db) / 2:.1f}"})
        if number % 9 == 4:
            writer.writerow(base | {"RS SNR": "n/a"})
    return text.getvalue() + f"\n\nExported Measurements\nC:\\synthetic\\cellpilot-{height_m}m.nmfs\n"


def main(folder: Path) -> None:
    """Write one log for each height."""
    for height_m in HEIGHTS_M:
        (folder / f"synthetic_{height_m}m.csv").write_text(log_text(height_m), encoding="utf-8")


if __name__ == "__main__":
    here = Path(__file__).resolve()
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else here.parents[2] / "src" / "cellpilot" / "data")
