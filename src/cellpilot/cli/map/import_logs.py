"""`cellpilot map import`: measured logs on a grid, with an account of every line."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.experiment import holdout_of, make_measured_map
from cellpilot.maps import account_of, save_map
from cellpilot.scenario import LogSettings, Paths, Positive


class ImportOptions(LogSettings):
    """Options of `map import`."""

    logs: tyro.conf.Positional[Paths] = Field(description="log files; several files = several heights, or parts of one flight")
    out: Path = Field(Path("map.nc"), description="RadioMap file to write (.nc, .zarr, .tif, .csv)", strict=False)
    holdout: bool = Field(False, description="also hide blocks of the measurements and print how well each method fills them")
    holdout_bin_m: Positive = Field(10.0, description="side of a cell in the hold-out check [m]")
    holdout_block_m: Positive = Field(60.0, description="side of a hidden block [m]")


def main(arguments: Sequence[str]) -> int:
    """Import, write, and tell what became of every line."""
    options = parse(ImportOptions, arguments, "cellpilot map import", "Grid measured logs into a map.")
    radio_map = make_measured_map(options)
    save_map(radio_map, options.out)
    for line in account_of(radio_map).lines():
        out.print(line)
    if options.holdout:
        _print_holdout(options)
    out.print(f"map: {options.out}")
    return 0


def _print_holdout(options: ImportOptions) -> None:
    table = Table(
        title=f"{options.holdout_block_m:g} m blocks hidden at all heights, {options.holdout_bin_m:g} m cells, mean of 10 splits"
    )
    for column in ("method", "RMSE [dB]", "MAE [dB]", "within 95 % interval", "answered"):
        table.add_column(column, justify="left" if column == "method" else "right")
    for name, result in holdout_of(options, options.holdout_bin_m, options.holdout_block_m).items():
        table.add_row(name, f"{result.rmse_db:.3f}", f"{result.mae_db:.3f}", f"{result.coverage:.1%}", f"{result.answered:.1%}")
    out.print(table)
