"""`cellpilot map import`: measured logs on a grid, with an account of every line; or maps that Sionna RT has saved."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import out, share_bar
from cellpilot.cli.options import parse, refuse_idle, refuse_overwriting
from cellpilot.errors import InputError
from cellpilot.experiment import holdout_of, make_measured_map
from cellpilot.maps import account_of, save_map
from cellpilot.maps.sources.sionna_file import SUFFIX, Receiver, read_sionna
from cellpilot.maps.words import blocked_words
from cellpilot.scenario import LogSettings, NonNegative, Paths, Positive, Settings


class ReceiverOptions(Settings):
    """The network behind a saved Sionna map (.npz) of path gains, the same for all its transmitters."""

    power_dbm: float = Field(Receiver.power_dbm, ge=-100, le=100, description="transmit power [dBm]")
    carrier_hz: Positive = Field(Receiver.carrier_hz, description="carrier frequency [Hz]")
    bandwidth_hz: Positive = Field(Receiver.bandwidth_hz, description="channel bandwidth [Hz]")
    noise_figure_db: NonNegative = Field(Receiver.noise_figure_db, description="noise figure of the receiver [dB]")
    load: float = Field(Receiver.load, ge=0, le=1, description="share of resources the interferers use (0..1)")


class ImportOptions(LogSettings):
    """Options of `map import`."""

    logs: tyro.conf.Positional[Paths] = Field(
        description="log files; several files = several heights, or parts of one flight. Or maps saved by Sionna RT (.npz)"
    )
    out: Path = Field(Path("map.nc"), description="RadioMap file to write (.nc, .zarr, .tif, .csv)", strict=False)
    holdout: bool = Field(False, description="also hide blocks of the measurements and print how well each method fills them")
    holdout_bin_m: Positive = Field(10.0, description="side of a cell in the hold-out check [m]")
    holdout_block_m: Positive = Field(60.0, description="side of a hidden block [m]")
    receiver: ReceiverOptions = ReceiverOptions()


def main(arguments: Sequence[str]) -> int:
    """Import, write, and tell what became of every line."""
    options = parse(ImportOptions, arguments, "cellpilot map import", "Grid measured logs into a map.")
    refuse_overwriting(options.out, (*options.logs, options.trend))
    if not options.logs:
        raise InputError("no file given; expected measured logs (.csv), or maps saved by Sionna RT (.npz)")
    saved = [path for path in options.logs if path.suffix.lower() == SUFFIX]
    if saved:
        idle = tuple(name for name in ImportOptions.model_fields if name not in ("logs", "out", "receiver"))
        refuse_idle(options, idle, "is for logs, not for saved Sionna maps (.npz)")
    else:
        refuse_idle(options, ("receiver",), "is for saved Sionna maps (.npz), not for logs")
        if not options.holdout:
            refuse_idle(options, ("holdout_bin_m", "holdout_block_m"), "is for --holdout")
    if saved and len(saved) < len(options.logs):
        raise InputError(f"{saved[0]} is a saved Sionna map, other files are logs: import them apart")
    if saved:
        radio_map = read_sionna(saved, Receiver(**options.receiver.model_dump()))
        save_map(radio_map, options.out)
        out.print(f"{radio_map.attrs['model']}; {blocked_words(radio_map)}")
        if "receiver" in radio_map.attrs:
            out.print(radio_map.attrs["receiver"])
    else:
        with share_bar("fill") as progress:
            radio_map = make_measured_map(options, progress=progress)
        checked = _holdout_table(options) if options.holdout else None
        save_map(radio_map, options.out)
        for line in account_of(radio_map).lines():
            out.print(line)
        if checked is not None:
            out.print(checked)
    out.print(f"map: {options.out}")
    return 0


def _holdout_table(options: ImportOptions) -> Table:
    table = Table(
        title=f"{options.holdout_block_m:g} m blocks hidden at all heights, {options.holdout_bin_m:g} m cells, mean of 10 splits"
    )
    for column in ("method", "RMSE [dB]", "MAE [dB]", "within 95 % interval", "answered"):
        table.add_column(column, justify="left" if column == "method" else "right")
    with share_bar("hold-out") as progress:
        results = holdout_of(options, options.holdout_bin_m, options.holdout_block_m, progress)
    for name, result in results.items():
        table.add_row(name, f"{result.rmse_db:.3f}", f"{result.mae_db:.3f}", f"{result.coverage:.1%}", f"{result.answered:.1%}")
    return table
