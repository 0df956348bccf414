"""`cellpilot evaluate RUN`: baseline, optimum and learned policy on the same instances."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from cellpilot.cli.console import out, share_bar, warn
from cellpilot.cli.options import parse
from cellpilot.errors import WriteError
from cellpilot.scenario import Settings
from cellpilot.service import evaluate


class EvaluateOptions(Settings):
    """Options of `evaluate`."""

    run: tyro.conf.Positional[str] = Field(description="run folder, or a shipped scenario with a trained policy")
    map: Path | None = Field(
        None, description="evaluate on this map instead (same grid); the evaluation is not saved", strict=False
    )
    as_json: Annotated[bool, tyro.conf.arg(name="json")] = Field(False, description="print JSON and nothing else")


def main(arguments: Sequence[str]) -> int:
    """Verb `evaluate`."""
    options = parse(EvaluateOptions, arguments, "cellpilot evaluate", "Compare baseline, optimum and learned policy.")
    with share_bar("evaluate") as progress:
        found = evaluate(options.run, options.map, progress=progress, warn=warn)
    if options.as_json:
        sys.stdout.write(json.dumps(found.payload, indent=2) + "\n")
    else:
        from cellpilot.report.tables import mobility_table, text_table

        out.print(text_table(found.payload))
        out.print(mobility_table(found.payload))
    # Printed first: numbers that cannot be saved are not lost.
    if found.can_be_saved:
        try:
            found.save()
        except WriteError as error:
            warn(f"the evaluation was not saved: {error}")
    return 0
