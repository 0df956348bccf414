"""Trained policies for programs without cellpilot."""

from collections.abc import Callable
from pathlib import Path

from cellpilot.errors import InputError
from cellpilot.experiment import shipped_policy
from cellpilot.plugins import offered, refuse_taken
from cellpilot.policies import PolicyParameters, load_parameters
from cellpilot.policies.onnx_file import save_onnx
from cellpilot.runs import open_run
from cellpilot.runs.files import FILES
from cellpilot.scenario import SHIPPED, find_scenario
from cellpilot.storage import resolved

Export = Callable[[PolicyParameters, Path], None]
"""Writes a policy to a file."""
OWN_EXPORTS: dict[str, Export] = {"onnx": save_onnx}
GROUP_OF_EXPORTS = "cellpilot.exports"
"""Entry points of other packages: ending without its dot -> what writes a policy to a file."""


def exports() -> dict[str, Export]:
    """Writers by the ending of the file: our own, and those of installed packages (entry points `cellpilot.exports`)."""
    found = dict(OWN_EXPORTS)
    for name, (write, origin) in offered(GROUP_OF_EXPORTS).items():
        refuse_taken(GROUP_OF_EXPORTS, name, origin, OWN_EXPORTS)
        found[name] = write
    return found


def export_policy(source: str | Path, file: str | Path) -> PolicyParameters:
    """Write the trained policy of a run folder, shipped scenario or `.safetensors` file in the format of the file's ending.

    `InputError` if there is no policy, the ending is unknown, or the file is one of the run's own.
    """
    file, path = Path(file), Path(source)
    if file.is_dir():
        raise InputError(f"{file}: a folder; expected the file to write, for example {file}/policy.onnx")
    if resolved(file) == resolved(path):
        raise InputError(f"{file}: is read and would be overwritten; choose another name")
    if path.is_dir() and resolved(file.parent) == resolved(path) and file.name in FILES:
        raise InputError(f"{file}: a file of the run, which would be overwritten; choose another name")
    ending = file.suffix.removeprefix(".")
    write = OWN_EXPORTS.get(ending) or exports().get(ending)
    if write is None:
        raise InputError(f"{file}: expected a name that ends in {' or '.join(f'.{name}' for name in sorted(exports()))}")
    parameters = _parameters(str(source), path)
    write(parameters, file)
    return parameters


def _parameters(source: str, path: Path) -> PolicyParameters:
    if path.is_dir():
        parameters = open_run(path).parameters()
    elif path.suffix == ".safetensors":
        parameters = load_parameters(path)
    elif (SHIPPED / f"{source}.toml").is_file():
        parameters = shipped_policy(find_scenario(source))
    else:
        raise InputError(f"{source}: no such run folder, shipped scenario or policy file (.safetensors)")
    if parameters is None:
        raise InputError(f"{source} holds no trained policy; train first")
    return parameters
