"""`cellpilot map antenna FILE`: both cuts of an antenna file, and what it states."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.radio import read_antenna
from cellpilot.radio.settings import COLUMN
from cellpilot.scenario import Finite, Settings


class AntennaOptions(Settings):
    """Options of `map antenna`."""

    file: tyro.conf.Positional[Path] = Field(description="antenna file (.msi, .pln)", strict=False)
    out: Path | None = Field(None, description="picture to write (png, pdf or svg); default the file's name, here", strict=False)
    electrical_tilt_deg: Finite | None = Field(None, description="electrical downtilt to shift the vertical cut to [deg]")
    mechanical_tilt_deg: Finite = Field(COLUMN.mechanical_tilt_deg, description="mechanical downtilt [deg]")


def main(arguments: Sequence[str]) -> int:
    """Print and draw."""
    options = parse(AntennaOptions, arguments, "cellpilot map antenna", "Draw both cuts of an antenna.")
    from cellpilot.report.antenna import draw_antenna
    from cellpilot.report.figures import check_picture_name, save_figure

    path = options.out or Path(options.file.stem + ".png")
    check_picture_name(path)
    found = read_antenna(options.file)
    antenna = found.antenna(options.electrical_tilt_deg, options.mechanical_tilt_deg)
    carrier = "unknown frequency" if found.frequency_hz is None else f"{found.frequency_hz / 1e6:g} MHz"
    out.print(
        f"{options.file}: {antenna.name or 'no name'}, {carrier}, {found.gain_dbi:.2f} dBi, downtilt {antenna.downtilt_deg:g} deg"
    )
    save_figure(draw_antenna(antenna), path)
    out.print(f"picture: {path}")
    return 0
