"""`cellpilot adapt A B`: prepared on map A, deployed on the unknown network B; score against flights."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import tyro
from pydantic import Field
from rich.box import SIMPLE_HEAD
from rich.table import Table

from cellpilot.cli.console import out, share_bar, warn
from cellpilot.cli.options import command_line, parse
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER
from cellpilot.maps.settings import LOGS
from cellpilot.scenario import RewardSettings, Settings
from cellpilot.service import adapt
from cellpilot.service.adapting import ADAPT_FLIGHTS, ADAPT_SEEDS
from cellpilot.studies.adapt_arms import ARMS
from cellpilot.studies.adapt_maps import read_place, rewards_of
from cellpilot.studies.adapt_words import in_words, summary, verdict
from cellpilot.text import as_flags

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
    flights: int = Field(ADAPT_FLIGHTS, ge=1, le=10_000, description="flights on the unknown network")
    seeds: int = Field(ADAPT_SEEDS, ge=1, description="seeds 0..N-1 of each arm")
    arms: tuple[str, ...] = Field(tuple(ARMS), description="what is compared", strict=False)
    bin_m: float = Field(LOGS.bin_m, gt=0, allow_inf_nan=False, description="side of a cell of measured logs [m]")
    calibrate: str | None = Field(None, description="map or log of the same network known beforehand: gives A its mean level")
    deep_rounds: int = Field(FQIHER().rounds, ge=1, description="rounds of FQI-HER on A; many cells or few good ones need more")
    out: Path | None = Field(None, description="folder of the results; default runs/adapt-A-B; it goes on there", strict=False)
    task: RewardSettings = RewardSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `adapt`."""
    options = _options(arguments)
    _, scenario = read_place(options.b, options.bin_m)
    if scenario is not None:
        options = _options(arguments, AdaptOptions(a=options.a, b=options.b, task=rewards_of(scenario)))
    asked = {name: getattr(options, name) for name in AdaptOptions.model_fields}
    with share_bar("adapt") as progress:
        found = adapt(**asked, command=command_line(), progress=progress, warn=warn)
    _show(found.data)
    out.print(f"picture: {found.draw()}")
    return 0


def _options(arguments: Sequence[str], default: AdaptOptions | None = None) -> AdaptOptions:
    about = "Prepared on map A, deployed on the unknown network B: score against flights. The task is B's, where B is a scenario."
    return parse(AdaptOptions, arguments, "cellpilot adapt", about, default)


def _show(data: "Dataset") -> None:
    heads, *rows = summary(data)
    table = Table(
        title=f"{data.attrs['title']}: mean score over {data.sizes['seed']} seeds ± half of its 95 % interval", box=SIMPLE_HEAD
    )
    for head in heads:
        table.add_column(head, justify="right")
    for row in rows:
        table.add_row(*row)
    out.print(table)
    for line in [in_words(data), *verdict(data)]:
        out.print(as_flags(line))
