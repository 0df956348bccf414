"""`cellpilot export RUN --onnx FILE`: the trained policy for programs without cellpilot."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse
from cellpilot.errors import InputError
from cellpilot.scenario import Settings
from cellpilot.service import export_policy


class ExportOptions(Settings):
    """Options of `export`."""

    source: tyro.conf.Positional[str] = Field(description="run folder, shipped scenario with a trained policy, or .safetensors")
    onnx: Annotated[Path | None, tyro.conf.arg(aliases=("--out",))] = Field(
        None, description="file to write: .onnx (extra onnx), or the ending of an export that a package offers", strict=False
    )


def main(arguments: Sequence[str]) -> int:
    """Verb `export`."""
    options = parse(ExportOptions, arguments, "cellpilot export", "Write the trained policy for other programs.")
    if options.onnx is None:
        raise InputError("--onnx is missing; give the file to write, for example --onnx policy.onnx")
    try:
        parameters = export_policy(options.source, options.onnx)
    except InputError as error:
        raise InputError(f"--onnx {error}" if str(error).startswith(f"{options.onnx}: ") else str(error)) from error
    sides = " x ".join(map(str, parameters.sides))
    out.print(f"{options.onnx}: {parameters.architecture} policy of {sides} cells, {options.onnx.stat().st_size / 1e3:.0f} kB")
    return 0
