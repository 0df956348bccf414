"""`cellpilot adapt A B`: prepared on map A, deployed on the unknown network B; score against flights."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from pydantic import Field
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cellpilot.cli.console import out, share_bar, warn
from cellpilot.cli.options import command_line, parse
from cellpilot.errors import InputError
from cellpilot.experiment import make_task, threshold_warning
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps import grid_of, save_map
from cellpilot.maps.settings import LOGS
from cellpilot.provenance import versions
from cellpilot.scenario import RewardSettings, Scenario, Settings
from cellpilot.storage import hold, save_netcdf
from cellpilot.studies.adapt import adapt
from cellpilot.studies.adapt_arms import ARMS
from cellpilot.studies.adapt_maps import make_transfer, make_transfer_maps, read_place
from cellpilot.studies.adapt_words import in_words, summary, verdict

if TYPE_CHECKING:
    from xarray import Dataset


class AdaptOptions(Settings):
    """Options of `adapt`."""

    a: tyro.conf.Positional[str] = Field(
        description="what was prepared on: map file of any format, measured log (.csv) or scenario"
    )
    b: tyro.conf.Positional[str] = Field(
        description="the unknown truth, same grid: map file of any format, log (.csv) or scenario"
    )
    flights: int = Field(100, ge=1, le=10_000, description="flights on the unknown network")
    seeds: int = Field(20, ge=1, description="seeds 0..N-1 of each arm")
    arms: tuple[str, ...] = Field(tuple(ARMS), description="what is compared", strict=False)
    bin_m: float = Field(LOGS.bin_m, gt=0, allow_inf_nan=False, description="side of a cell of measured logs [m]")
    calibrate: str | None = Field(None, description="map or log of the same network known beforehand: gives A its mean level")
    deep_rounds: int = Field(FQIHER().rounds, ge=1, description="rounds of FQI-HER on A; many cells or few good ones need more")
    out: Path | None = Field(None, description="folder of the results; default runs/adapt-A-B; it goes on there", strict=False)
    task: RewardSettings = RewardSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `adapt`."""
    options = _options(arguments)
    (a, _), (b, scenario) = (read_place(text, options.bin_m) for text in (options.a, options.b))
    if scenario is not None:
        options = _options(arguments, AdaptOptions(a=options.a, b=options.b, task=_rewards_of(scenario)))
    if unknown := [name for name in options.arms if name not in ARMS]:
        raise InputError(f"--arms {unknown[0]}: no such arm; expected some of {', '.join(ARMS)}")
    calibration = None if options.calibrate is None else read_place(options.calibrate, options.bin_m)[0]
    map_a, map_b = make_transfer_maps(a, b, calibration)
    noise_std_db = options.task.noise_std_db
    deep = FQIHER(rounds=options.deep_rounds)
    transfer = make_transfer(map_a, map_b, make_task(options.task, grid_of(map_b)), noise_std_db, deep)
    warn(threshold_warning(transfer.truth, options.task.threshold_db))
    folder = options.out or Path("runs") / f"adapt-{Path(options.a).stem}-{Path(options.b).stem}"
    with hold(folder):
        with share_bar("adapt") as progress:
            data = adapt(transfer, options.flights, options.seeds, options.arms, progress, folder / "adapt")
        title = f"{Path(options.a).stem} to {Path(options.b).stem}"
        data.attrs |= {"title": title, "command": command_line(), "versions": json.dumps(versions())}
        save_map(map_a, folder / "map-a.nc")
        save_map(map_b, folder / "map-b.nc")
        save_netcdf(data, folder / "adapt.nc")
        _show(data, title)
        from cellpilot.report.figures import draw_study

        out.print(f"picture: {draw_study(folder, 'adapt')}")
    return 0


def _options(arguments: Sequence[str], default: AdaptOptions | None = None) -> AdaptOptions:
    about = "Prepared on map A, deployed on the unknown network B: score against flights. The task is B's, where B is a scenario."
    return parse(AdaptOptions, arguments, "cellpilot adapt", about, default)


def _rewards_of(scenario: Scenario) -> RewardSettings:
    """The task of a scenario; flights lead between random places, so one that fixes start or goal is refused."""
    if scenario.task.start is not None or scenario.task.goal is not None:
        raise InputError(f"the scenario {scenario.name} fixes start or goal; adapt flies between random places: leave them out")
    return RewardSettings(**scenario.task.model_dump(include=set(RewardSettings.model_fields)))


def _show(data: "Dataset", title: str) -> None:
    heads, *rows = summary(data)
    table = Table(title=f"{title}: mean score over {data.sizes['seed']} seeds ± half of its 95 % interval", box=SIMPLE_HEAD)
    for head in heads:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*row)
    out.print(table)
    for line in [in_words(data), *verdict(data)]:
        out.print(line)
