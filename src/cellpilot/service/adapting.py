"""Prepared on map A, deployed on the unknown network B."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pydantic import Field, Strict

from cellpilot.errors import InputError
from cellpilot.evaluate.evaluation import Progress
from cellpilot.experiment import make_task, threshold_warning
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps import grid_of, save_map
from cellpilot.maps.settings import LOGS
from cellpilot.provenance import versions
from cellpilot.scenario import Positive, RewardSettings, Settings
from cellpilot.service.callbacks import Warn, as_warning, tell, untold
from cellpilot.storage import hold, save_netcdf
from cellpilot.studies.adapt import adaptation
from cellpilot.studies.adapt_arms import ARMS
from cellpilot.studies.adapt_maps import make_transfer, make_transfer_maps, read_place, rewards_of

if TYPE_CHECKING:
    from xarray import Dataset


class AdaptSettings(Settings):
    """How long and how often is flown on the unknown network, and what is compared."""

    flights: int = Field(100, ge=1, le=10_000, description="flights on the unknown network")
    seeds: int = Field(20, ge=1, description="seeds 0..N-1 of each arm")
    arms: Annotated[tuple[str, ...], Strict(False)] = Field(tuple(ARMS), min_length=1, description="what is compared")
    bin_m: Positive = Field(LOGS.bin_m, description="side of a cell of measured logs [m]")
    deep_rounds: int = Field(FQIHER().rounds, ge=1, description="rounds of FQI-HER on A; many cells or few good ones need more")


AS_USUAL = AdaptSettings()


@dataclass(frozen=True)
class Adapted:
    """Curves over (arm, seed, flights), and the folder that holds them with both maps."""

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
    settings: AdaptSettings = AS_USUAL,
    *,
    calibrate: str | None = None,
    out: str | Path | None = None,
    task: RewardSettings | None = None,
    command: str = "cellpilot.service.adapt",
    progress: Progress = untold,
    warn: Warn = as_warning,
) -> Adapted:
    """Score against flights on B of everything in `settings.arms`, seeds 0 to `settings.seeds` - 1.

    `a`, `b`, `calibrate`: map file of any format, measured log (.csv, cells of `settings.bin_m`) or scenario. `task`: that of B
    where it is a scenario. `out`: default `runs/adapt-A-B`; a study that was stopped goes on there. `InputError` names what
    cannot be used.
    """
    if unknown := [name for name in settings.arms if name not in ARMS]:
        raise InputError(f"`arms` {unknown[0]}: no such arm; expected some of {', '.join(ARMS)}")
    (of_a, _), (of_b, scenario) = (read_place(text, settings.bin_m) for text in (a, b))
    rewards = task or (RewardSettings() if scenario is None else rewards_of(scenario))
    calibration = None if calibrate is None else read_place(calibrate, settings.bin_m)[0]
    map_a, map_b = make_transfer_maps(of_a, of_b, calibration)
    deep = FQIHER(rounds=settings.deep_rounds)
    transfer = make_transfer(map_a, map_b, make_task(rewards, grid_of(map_b)), rewards.noise_std_db, deep)
    tell(warn, threshold_warning(transfer.truth, rewards.threshold_db))
    folder = Path("runs") / f"adapt-{Path(a).stem}-{Path(b).stem}" if out is None else Path(out)
    with hold(folder):
        data = adaptation(transfer, settings.flights, settings.seeds, settings.arms, progress, folder / "adapt")
        title = f"{Path(a).stem} to {Path(b).stem}"
        data.attrs |= {"title": title, "command": command, "versions": json.dumps(versions())}
        save_map(map_a, folder / "map-a.nc")
        save_map(map_b, folder / "map-b.nc")
        save_netcdf(data, folder / "adapt.nc")
    return Adapted(data, folder)
