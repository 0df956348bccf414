"""`cellpilot map info`: what a map holds, in words."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out, warn
from cellpilot.cli.options import parse
from cellpilot.experiment import threshold_warning
from cellpilot.maps import load_map
from cellpilot.maps.files import has_checksum
from cellpilot.maps.words import described
from cellpilot.scenario import Settings
from cellpilot.task import Task
from cellpilot.world import World


class InfoOptions(Settings):
    """Options of `map info`."""

    file: tyro.conf.Positional[Path] = Field(description="RadioMap file", strict=False)
    threshold_db: float = Field(Task.threshold_db, allow_inf_nan=False, description="SINR threshold [dB]")


def main(arguments: Sequence[str]) -> int:
    """Print it."""
    options = parse(InfoOptions, arguments, "cellpilot map info", "What a map holds.")
    radio_map = load_map(options.file)
    out.print(f"{options.file}")
    for line in described(radio_map, options.threshold_db):
        out.print(f"  {line}")
    if not has_checksum(options.file):
        out.print("  no checksum: damage to its numbers would not be noticed; cellpilot map convert writes one")
    warn(threshold_warning(World.from_map(radio_map), options.threshold_db))
    return 0
