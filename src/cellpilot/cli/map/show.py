"""`cellpilot map show`: pictures of a map."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse, refuse_idle
from cellpilot.maps import load_map
from cellpilot.scenario import NonNegative, Settings
from cellpilot.signal import NO_NOISE_DB
from cellpilot.task import Task


class ShowOptions(Settings):
    """Options of `map show`."""

    file: tyro.conf.Positional[Path] = Field(description="RadioMap file", strict=False)
    out: Path | None = Field(None, description="picture to write (png, pdf or svg); default beside the map", strict=False)
    what: Literal["sinr", "probability", "serving", "spread", "uncertainty", "count", "cdf"] = Field(
        "sinr", description="what to draw"
    )
    threshold_db: float = Field(Task.threshold_db, allow_inf_nan=False, description="SINR threshold [dB]")
    noise_std_db: NonNegative = Field(NO_NOISE_DB, description="noise of a measurement, for the probability [dB]")


def main(arguments: Sequence[str]) -> int:
    """Draw and save."""
    options = parse(ShowOptions, arguments, "cellpilot map show", "Draw a map.")
    if options.what not in ("sinr", "probability", "cdf"):
        refuse_idle(options, ("threshold_db",), "is for --what sinr, probability or cdf")
    if options.what != "probability":
        refuse_idle(options, ("noise_std_db",), "is for --what probability")
    from cellpilot.report.figures import check_picture_name, save_figure
    from cellpilot.report.map_views import draw_map, heights_left_out

    default = options.file.with_suffix(".png" if options.what == "sinr" else f".{options.what}.png")
    path = options.out or default
    check_picture_name(path)
    radio_map = load_map(options.file)
    save_figure(draw_map(radio_map, options.what, options.threshold_db, options.noise_std_db), path)
    out.print(f"picture: {path}{heights_left_out(radio_map)}")
    return 0
