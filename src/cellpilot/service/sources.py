"""What a person can name: a map file, a run folder, a scenario."""

from dataclasses import dataclass, field
from pathlib import Path

from cellpilot.experiment import build_map, shipped_policy
from cellpilot.maps import RadioMap, load_map
from cellpilot.policies import PolicyParameters
from cellpilot.runs import Run, open_run, open_run_or_shipped, origin_warning
from cellpilot.scenario import SHIPPED, AirspaceSettings, RewardSettings, find_scenario, load_scenario
from cellpilot.service.callbacks import Warn, as_warning, tell


@dataclass(frozen=True)
class Source:
    """A map with the task, airspace and trained policy that belong to it; defaults for a map alone."""

    name: str
    radio_map: RadioMap
    task: RewardSettings = field(default_factory=RewardSettings)
    airspace: AirspaceSettings = field(default_factory=AirspaceSettings)
    parameters: PolicyParameters | None = None


def load_run(name: str | Path) -> Run:
    """The run in a folder, or one around a policy that ships with the package; `InputError` if it is neither."""
    return open_run_or_shipped(str(name))


def open_source(source: Run | str | Path, warn: Warn = as_warning) -> Source:
    """What a run, a map file, a run folder or a scenario (TOML file or shipped name) holds; `InputError` if none."""
    path = source.folder if isinstance(source, Run) else Path(source)
    if isinstance(source, Run) or (path.is_dir() and path.suffix.lower() != ".zarr"):
        run = source if isinstance(source, Run) else open_run(path)
        parameters = run.parameters()
        if parameters is not None:
            tell(warn, origin_warning(parameters, run.radio_map, run.task, run.seed))
        return Source(str(path), run.radio_map, run.scenario.task, run.scenario.airspace, parameters)
    if path.suffix == ".toml" or (SHIPPED / f"{source}.toml").is_file():
        file = find_scenario(str(source))
        scenario = load_scenario(file)
        return Source(str(source), build_map(scenario.map), scenario.task, scenario.airspace, shipped_policy(file))
    return Source(str(source), load_map(path))
