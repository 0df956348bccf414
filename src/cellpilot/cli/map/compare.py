"""`cellpilot map compare A B`: how two maps of one grid differ."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field
from rich.table import Table

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.maps import load_map
from cellpilot.maps.compare import compared
from cellpilot.scenario import Settings
from cellpilot.task import Task


class CompareOptions(Settings):
    """Options of `map compare`."""

    a: tyro.conf.Positional[Path] = Field(description="RadioMap file", strict=False)
    b: tyro.conf.Positional[Path] = Field(description="RadioMap file of the same grid", strict=False)
    out: Path = Field(Path("compare.png"), description="picture to write (png, pdf or svg)", strict=False)
    threshold_db: float = Field(Task.threshold_db, allow_inf_nan=False, description="SINR threshold [dB]")


def main(arguments: Sequence[str]) -> int:
    """Print the figures and draw both maps with their difference."""
    options = parse(CompareOptions, arguments, "cellpilot map compare", "Compare two maps of one grid.")
    from cellpilot.report.comparison import draw_comparison
    from cellpilot.report.figures import check_picture_name, save_figure
    from cellpilot.report.map_views import heights_left_out

    check_picture_name(options.out)
    a, b = load_map(options.a), load_map(options.b)
    table = Table(title=f"{options.b} less {options.a}, cells known in both")
    columns = ("height [m]", "cells", "mean difference [dB]", "RMS difference [dB]", "correlation", "agree on the threshold")
    for column in columns:
        table.add_column(column, justify="right")
    for row in compared(a, b, options.threshold_db, str(options.a), str(options.b)):
        figures = (f"{row.mean_db:+.2f}", f"{row.rms_db:.2f}", f"{row.correlation:.3f}", f"{row.agreement:.1%}")
        table.add_row(row.height, str(row.cells), *figures)
    out.print(table)
    save_figure(draw_comparison(a, b, (options.a.stem, options.b.stem), options.threshold_db), options.out)
    out.print(f"picture: {options.out}{heights_left_out(a)}")
    return 0
