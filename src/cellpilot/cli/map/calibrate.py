"""`cellpilot map calibrate SIMULATED --to MEASURED`: offset and spread of a simulation from measurements."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import out
from cellpilot.cli.options import parse, refuse_overwriting
from cellpilot.maps import load_map, save_map
from cellpilot.maps.calibrate import calibrate
from cellpilot.scenario import Settings


class CalibrateOptions(Settings):
    """Options of `map calibrate`."""

    simulated: tyro.conf.Positional[Path] = Field(description="map to shift and stretch", strict=False)
    to: Path = Field(description="measured map (cellpilot map import) on any grid", strict=False)
    out: Path = Field(Path("calibrated.nc"), description="RadioMap file to write", strict=False)


def main(arguments: Sequence[str]) -> int:
    """Calibrate, write, print before and after."""
    options = parse(CalibrateOptions, arguments, "cellpilot map calibrate", "Fit a simulated map to measurements.")
    refuse_overwriting(options.out, (options.simulated, options.to))
    result = calibrate(load_map(options.simulated), load_map(options.to))
    save_map(result.radio_map, options.out)
    table = Table(title=f"{result.cells} measured cells within the simulated map")
    for column in ("", "mean error [dB]", "spread ratio", "RMSE [dB]", "correlation"):
        table.add_column(column, justify="right")
    for name, fit in (("before", result.before), ("after", result.after)):
        table.add_row(
            name, f"{fit.mean_error_db:+.2f}", f"{fit.spread_ratio:.3f}", f"{fit.rmse_db:.2f}", f"{fit.correlation:.3f}"
        )
    out.print(table)
    out.print(
        f"offset {result.offset_db:+.2f} dB (standard error {result.offset_std_db:.2f} dB), spread x {result.spread_factor:.3f};"
        f" map: {options.out}"
    )
    return 0
