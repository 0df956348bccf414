"""`cellpilot export RUN --onnx FILE`: the trained policy for programs without cellpilot."""

from collections.abc import Sequence
from pathlib import Path

import tyro
from pydantic import Field

from cellpilot.cli.console import out
from cellpilot.cli.options import parse, refuse_overwriting
from cellpilot.errors import InputError
from cellpilot.experiment import shipped_policy
from cellpilot.policies import PolicyParameters, load_parameters
from cellpilot.policies.onnx_file import save_onnx
from cellpilot.runs import open_run
from cellpilot.runs.files import FILES
from cellpilot.scenario import SHIPPED, Settings, find_scenario
from cellpilot.storage import resolved


class ExportOptions(Settings):
    """Options of `export`."""

    source: tyro.conf.Positional[str] = Field(description="run folder, shipped scenario with a trained policy, or .safetensors")
    onnx: Path | None = Field(None, description="ONNX file to write (extra onnx)", strict=False)


def main(arguments: Sequence[str]) -> int:
    """Verb `export`."""
    options = parse(ExportOptions, arguments, "cellpilot export", "Write the trained policy for other programs.")
    if options.onnx is None:
        raise InputError("--onnx is missing; give the file to write, for example --onnx policy.onnx")
    if options.onnx.is_dir():
        raise InputError(f"--onnx {options.onnx}: a folder; expected the file to write, for example {options.onnx}/policy.onnx")
    _refuse_own_files(options.source, options.onnx)
    if options.onnx.suffix != ".onnx":
        raise InputError(f"--onnx {options.onnx}: expected a name that ends in .onnx")
    parameters = _parameters(options.source)
    save_onnx(parameters, options.onnx)
    sides = " x ".join(map(str, parameters.sides))
    out.print(f"{options.onnx}: {parameters.architecture} policy of {sides} cells, {options.onnx.stat().st_size / 1e3:.0f} kB")
    return 0


def _refuse_own_files(source: str, out: Path) -> None:
    """`InputError` if the output would take the place of what is exported, or of another file of its run."""
    path = Path(source)
    refuse_overwriting(out, [path], "--onnx")
    if path.is_dir() and resolved(out.parent) == resolved(path) and out.name in FILES:
        raise InputError(f"--onnx {out}: a file of the run, which would be overwritten; choose another name")


def _parameters(source: str) -> PolicyParameters:
    path = Path(source)
    if path.is_dir():
        parameters = open_run(path).parameters()
    elif path.suffix == ".safetensors":
        parameters = load_parameters(path)
    elif (SHIPPED / f"{source}.toml").is_file():
        parameters = shipped_policy(find_scenario(source))
    else:
        raise InputError(f"{source}: no such run folder, shipped scenario or policy file (.safetensors)")
    if parameters is None:
        raise InputError(f"{source} holds no trained policy; train first (cellpilot train)")
    return parameters
