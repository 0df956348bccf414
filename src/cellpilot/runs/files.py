"""What lies in a run folder: which files are ours, when it counts as empty, and what `run.json` may say."""

from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from cellpilot.errors import InputError
from cellpilot.storage import LOCK, TEMPORARY, read_json

SCENARIO, FACTS, MAP = "scenario.toml", "run.json", "map.nc"
MARKERS = (SCENARIO, FACTS)
FILES = {
    *MARKERS,
    MAP,
    "state.safetensors",
    "train.nc",
    "policy.safetensors",
    "eval.nc",
    "report.html",
    "ablation.nc",
    "sensitivity.nc",
}
"""Files of a run. Only a folder with nothing but these and `FOLDERS` is ever replaced."""
FIGURE_STEMS = (
    "deployment",
    "sinr_map",
    "low_probability",
    "cdf_sinr",
    "cdf_path_ratio",
    "cdf_return",
    "policy_low_goal",
    "policy_high_goal",
    "altitude",
    "training",
    "ablation",
    "sensitivity",
)
"""Names of the figures of a report."""
FOLDERS = {
    "figures": tuple(f"{stem}{suffix}" for stem in FIGURE_STEMS for suffix in (".png", ".pdf")),
    "ablation": ("*.npy", "*.safetensors"),
    "sensitivity": ("*.safetensors",),
    "tensorboard": ("events.*",),
}
"""Folders of a run, and what in them is ours."""
NOT_A_RUN = "restore it, or train again"
Seconds = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Many = Annotated[int, Field(ge=0, lt=2**63)]


class RunFacts(BaseModel):
    """`run.json`: what is known of a run besides its settings."""

    model_config = ConfigDict(strict=True, extra="ignore")

    seed: int = Field(ge=0, lt=2**31)
    command: str | None = None
    versions: dict[str, str] = {}
    started: str | None = None
    train_wall_s: Seconds | None = None
    compile_s: Seconds | None = None
    updates: Many | None = None
    env_steps: Many | None = None
    cores: Many | None = None


def read_facts(folder: Path) -> RunFacts:
    """What `run.json` says; `InputError` in one line that names the entry which is missing or of another kind."""
    path = folder / FACTS
    found = read_json(path, NOT_A_RUN)
    try:
        return RunFacts.model_validate(found)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        entry = ".".join(map(str, first["loc"]))
        value = "" if first["type"] == "missing" else f" is {_short(first['input'])}"
        raise InputError(f"{path}: {entry}{value}: {first['msg'][0].lower()}{first['msg'][1:]}; {NOT_A_RUN}") from None


def is_occupied(folder: Path, force: bool) -> bool:
    """Whether a run in the folder has to go first; `InputError` if there is one (unless `force`) or other files.

    What a kill left before the first run was complete counts as nothing.
    """
    if not folder.exists() and not folder.is_symlink():
        return False
    if not folder.is_dir():
        raise InputError(f"{folder}: a file; choose an empty folder or a free name")
    names = {entry.name for entry in folder.iterdir() if not _passing(entry.name)}
    if not names or names == {FACTS} or names == {FACTS, MAP}:
        return False
    replaceable = names <= FILES | FOLDERS.keys()
    if not (force and replaceable):
        hints = ["go on with `resume`"] * holds_run(folder) + ["replace it with `force`"] * (replaceable and not force)
        raise InputError(f"{folder} is not empty; {', or '.join([*hints, 'choose an empty folder'])}")
    return True


def remove_run(folder: Path) -> None:
    """Delete what cellpilot made in a run folder; a person's own files in its folders stay."""
    for name in FILES:
        (folder / name).unlink(missing_ok=True)
    for name, patterns in FOLDERS.items():
        for pattern in patterns:
            for file in (folder / name).glob(pattern):
                file.unlink()
        if (folder / name).is_dir() and not any((folder / name).iterdir()):
            (folder / name).rmdir()


def holds_run(folder: Path) -> bool:
    """Whether the folder is a run."""
    return all((folder / marker).is_file() for marker in MARKERS)


def _passing(name: str) -> bool:
    return name == LOCK or name.startswith(TEMPORARY)


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
