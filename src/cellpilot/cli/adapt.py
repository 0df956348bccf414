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
from cellpilot.scenario import RewardSettings
from cellpilot.service import adapt
from cellpilot.service.adapting import AdaptSettings
from cellpilot.studies.adapt_maps import read_place, rewards_of
from cellpilot.studies.adapt_words import in_words, summary, verdict
from cellpilot.text import as_flags

if TYPE_CHECKING:
    from xarray import Dataset


class AdaptOptions(AdaptSettings):
    """Options of `adapt`."""

    a: tyro.conf.Positional[str] = Field(
        description="what was prepared on: map file of any format, measured log (.csv) or scenario"
    )
    b: tyro.conf.Positional[str] = Field(
        description="the unknown truth, same grid: map file of any format, log (.csv) or scenario"
    )
    calibrate: str | None = Field(None, description="map or log of the same network known beforehand: gives A its mean level")
    out: Path | None = Field(None, description="folder of the results; default runs/adapt-A-B; it goes on there", strict=False)
    task: RewardSettings = RewardSettings()


def main(arguments: Sequence[str]) -> int:
    """Verb `adapt`."""
    options = _options(arguments)
    _, scenario = read_place(options.b, options.bin_m)
    if scenario is not None:
        options = _options(arguments, AdaptOptions(a=options.a, b=options.b, task=rewards_of(scenario)))
    with share_bar("adapt") as progress:
        found = adapt(
            options.a,
            options.b,
            options,
            calibrate=options.calibrate,
            out=options.out,
            task=options.task,
            command=command_line(),
            progress=progress,
            warn=warn,
        )
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
