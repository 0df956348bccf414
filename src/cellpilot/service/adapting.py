"""Prepared on map A, deployed on the unknown network B."""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from cellpilot.errors import InputError
from cellpilot.evaluate.evaluation import Progress
from cellpilot.experiment import make_task, threshold_warning
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps import grid_of, save_map
from cellpilot.maps.settings import LOGS
from cellpilot.provenance import versions
from cellpilot.scenario import RewardSettings
from cellpilot.service.callbacks import Warn, as_warning, tell, untold
from cellpilot.storage import hold, save_netcdf
from cellpilot.studies.adapt import adaptation
from cellpilot.studies.adapt_arms import ARMS
from cellpilot.studies.adapt_maps import make_transfer, make_transfer_maps, read_place, rewards_of

if TYPE_CHECKING:
    from xarray import Dataset


ADAPT_FLIGHTS, ADAPT_SEEDS = 100, 20
"""Flights on the unknown network, and seeds of each arm, if nobody says."""


@dataclass(frozen=True)
class Adapted:
    """Curves over (arm, seed, flights), the folder that holds them with both maps."""

    data: "Dataset"
    folder: Path

    def draw(self) -> Path:
        """Write the picture of the curves into the folder; its path. `WriteError` where it cannot be written."""
        from cellpilot.report.figures import draw_study

        with hold(self.folder):
            return draw_study(self.folder, "adapt")


def adapt(
    a: str,
    b: str,
    *,
    flights: int = ADAPT_FLIGHTS,
    seeds: int = ADAPT_SEEDS,
    arms: Sequence[str] = tuple(ARMS),
    bin_m: float = LOGS.bin_m,
    calibrate: str | None = None,
    deep_rounds: int | None = None,
    out: str | Path | None = None,
    task: RewardSettings | None = None,
    command: str = "cellpilot.service.adapt",
    progress: Progress = untold,
    warn: Warn = as_warning,
) -> Adapted:
    """Score against flights on B of everything in `arms`, seeds 0 to `seeds` - 1.

    `a`, `b`, `calibrate`: map file of any format, measured log (.csv, cells of `bin_m`) or scenario. `task`: that of B where
    it is a scenario. `deep_rounds`: rounds of FQI-HER on A. `out`: default `runs/adapt-A-B`; a study that was stopped goes
    on there. `InputError` names what cannot be used.
    """
    if unknown := [name for name in arms if name not in ARMS]:
        raise InputError(f"`arms` {unknown[0]}: no such arm; expected some of {', '.join(ARMS)}")
    (of_a, _), (of_b, scenario) = (read_place(text, bin_m) for text in (a, b))
    settings = task or (RewardSettings() if scenario is None else rewards_of(scenario))
    calibration = None if calibrate is None else read_place(calibrate, bin_m)[0]
    map_a, map_b = make_transfer_maps(of_a, of_b, calibration)
    deep = FQIHER() if deep_rounds is None else FQIHER(rounds=deep_rounds)
    transfer = make_transfer(map_a, map_b, make_task(settings, grid_of(map_b)), settings.noise_std_db, deep)
    tell(warn, threshold_warning(transfer.truth, settings.threshold_db))
    folder = Path("runs") / f"adapt-{Path(a).stem}-{Path(b).stem}" if out is None else Path(out)
    with hold(folder):
        data = adaptation(transfer, flights, seeds, tuple(arms), progress, folder / "adapt")
        title = f"{Path(a).stem} to {Path(b).stem}"
        data.attrs |= {"title": title, "command": command, "versions": json.dumps(versions())}
        save_map(map_a, folder / "map-a.nc")
        save_map(map_b, folder / "map-b.nc")
        save_netcdf(data, folder / "adapt.nc")
    return Adapted(data, folder)
