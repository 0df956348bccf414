"""`Scenario` = map + task + learner + evaluation. TOML files and command-line flags are two views of it.

Every value of the thesis is a default here, with its table or section. Unknown keys are refused.
"""

import json
import re
import tomllib
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro
from pydantic import BaseModel, ConfigDict, Field, Strict, ValidationError, model_validator

from cellpilot.errors import InputError
from cellpilot.learn.algorithms.fqi_her_settings import FQIHER

NonNegative = Annotated[float, Field(ge=0, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Count = Annotated[int, Field(ge=1)]
Pair = Annotated[tuple[Finite, Finite], Strict(False)]
Cell = Annotated[tuple[int, int, int], Strict(False)]
Floats = Annotated[tuple[Finite, ...], Strict(False)]
Paths = Annotated[tuple[Annotated[Path, Strict(False)], ...], Strict(False)]


class Settings(BaseModel):
    """Base of all sections: frozen, strict types, unknown keys refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", strict=True)


class SimulatedMap(Settings):
    """A map simulated after 3GPP TR 36.777 over a hexagonal deployment, or over the sectors of a site list."""

    kind: Annotated[Literal["simulated"], tyro.conf.Suppress] = "simulated"
    heights_m: Floats = Field((30.0,), description="flight heights [m], increasing (section 4.2.1: 30, or 20..100)")
    x_range_m: Pair = Field((-200.0, 200.0), description="west and east border [m] (section 4.2.1)")
    y_range_m: Pair = Field((-200.0, 200.0), description="south and north border [m] (section 4.2.1)")
    bin_m: Positive = Field(20.0, description="side of a cell [m] (section 4.2.1)")
    points_per_side: Count = Field(8, description="simulated points along each side of a cell, averaged in dB")
    environment: Literal["UMa-AV", "UMi-AV", "RMa-AV"] = Field("UMa-AV", description="3GPP TR 36.777 scenario")
    los: Literal["soft", "sampled", "los", "nlos"] = Field("soft", description="line of sight: averaged, drawn or forced")
    shadowing_seed: int | None = Field(None, ge=0, lt=2**63, description="seed of shadowing and sampled LOS; None = no shadowing")
    sites: Annotated[Path, Strict(False)] | None = Field(None, description="site list (CSV) instead of the hexagonal deployment below")
    anchor: Pair | None = Field(None, description="LAT LON of x = y = 0 [deg]; None = the middle of the site list")
    rings: int = Field(1, ge=0, description="rings of sites around the centre site; 1 = 7 sites (Table 4.1)")
    inter_site_distance_m: Positive = Field(500.0, description="distance between sites [m] (Table 4.1)")
    boresights_deg: Floats = Field((30.0, 150.0, 270.0), description="sector boresights, counter-clockwise from east [deg]")
    base_height_m: Positive = Field(25.0, description="antenna height [m] (section 4.2.1)")
    power_dbm: Finite = Field(48.0, description="power of each sector [dBm] (Table 4.1)")
    carrier_hz: Positive = Field(2e9, description="carrier frequency [Hz] (Table 4.1)")
    bandwidth_hz: Positive = Field(10e6, description="carrier bandwidth [Hz] (Table 4.1)")
    noise_figure_db: Finite = Field(9.0, description="receiver noise figure [dB]")
    load: float = Field(1.0, ge=0, le=1, description="share of resources the interferers use (0..1)")
    antenna_elements: Count = Field(10, description="elements of the antenna column")
    antenna_spacing_wavelengths: Positive = Field(0.8, description="distance between elements [wavelengths]")
    electrical_tilt_deg: Finite = Field(7.0, description="electrical downtilt [deg]")
    mechanical_tilt_deg: Finite = Field(0.0, description="mechanical downtilt [deg]")
    array_factor_floor_db: Finite = Field(-40.0, description="null fill of the array factor [dB]")

    @model_validator(mode="after")
    def _one_deployment(self) -> "SimulatedMap":
        for name in HEXAGONAL if self.sites is not None else ():
            if getattr(self, name) != type(self).model_fields[name].default:
                raise ValueError(f"{name} belongs to the hexagonal deployment, but sites come from {self.sites}: leave one of them out")
        return self


HEXAGONAL = (
    "rings", "inter_site_distance_m", "boresights_deg", "base_height_m", "power_dbm", "carrier_hz", "bandwidth_hz", "load",
    "antenna_elements", "antenna_spacing_wavelengths", "electrical_tilt_deg", "mechanical_tilt_deg", "array_factor_floor_db",
)  # fmt: skip
"""Settings that a site list replaces."""


class LogSettings(Settings):
    """How measured logs become a map."""

    logs: Paths = Field((), description="log files; several files = several heights, or parts of one flight")
    altitude_m: float | None = Field(None, ge=0, description="height of the logs [m]; None = as the logs or their file names say")
    ground_altitude_m: Finite | None = Field(None, description="altitude of height 0 [m] for logs that count from ellipsoid or sea")
    height_step_m: Positive = Field(10.0, description="altitudes of a log are put on multiples of this [m]")
    columns: str | None = Field(None, description="columns of a log of unknown kind: lat=..,lon=..,sinr=..,alt=..,rsrp=..,cell=..")
    altitude_unit: Literal["m", "ft"] | None = Field(None, description="unit of the altitude column where its name does not say")
    altitude_reference: Literal["take-off", "ellipsoid", "sea-level"] | None = Field(
        None, description="what the altitude column counts from"
    )
    max_accuracy_m: Positive = Field(30.0, description="leave out samples at positions less certain than this [m]")
    max_age_s: Positive = Field(5.0, description="leave out samples at positions older than this [s]")
    bin_m: Positive = Field(40.0, description="side of a cell [m]")
    fill: Literal["inverse-distance", "gaussian-process"] = Field("inverse-distance", description="how holes are filled")
    fill_radius_m: NonNegative = Field(80.0, description="fill holes from neighbours within [m]; 0 = leave holes")
    trend: Annotated[Path, Strict(False)] | None = Field(
        None, description="site list: the Gaussian process departs from its simulation, fitted to the log"
    )
    trend_environment: Literal["UMa-AV", "UMi-AV", "RMa-AV"] = Field("UMa-AV", description="3GPP scenario of that simulation")
    mask: Annotated[tuple[Finite, Finite, Finite], Strict(False)] | Literal["auto", "none"] = Field(
        "auto", description="leave out samples within LAT LON RADIUS_M; auto = the hover at take-off, if there is one"
    )
    unknown: Literal["blocked", "bad"] = Field("blocked", description="what an unknown cell is: not to be entered, or bad signal")

    @model_validator(mode="after")
    def _trend_is_used(self) -> "LogSettings":
        if self.trend is not None and self.fill != "gaussian-process":
            raise ValueError(f"trend is for the Gaussian process, but holes are filled by {self.fill}: set fill to gaussian-process")
        return self


class MeasuredMap(LogSettings):
    """A map gridded from measured logs."""

    kind: Annotated[Literal["measured"], tyro.conf.Suppress] = "measured"


class MapFile(Settings):
    """A radio map read from a NetCDF file."""

    kind: Annotated[Literal["file"], tyro.conf.Suppress] = "file"
    path: Annotated[Path, Strict(False)] = Field(Path("map.nc"), description="RadioMap file (cellpilot map writes them)")


class RewardSettings(Settings):
    """What a flight earns and when it ends (section 4.2.2)."""

    rho_goal: Finite = Field(10.0, description="reward for reaching the goal (Table 4.2)")
    rho_sinr: Finite = Field(-1.0, description="reward of a step below the threshold (Table 4.2)")
    rho_step: Finite = Field(-0.1, description="reward of every step (Table 4.2)")
    rho_blocked: Finite = Field(0.0, description="reward of a move that a blocked cell stops")
    threshold_db: Finite = Field(3.0, description="SINR threshold [dB] (section 4.4.2)")
    noise_std_db: NonNegative = Field(
        0.0, description="standard deviation of the noise drawn at every step [dB] (section 5.2: 2)"
    )
    discount: float = Field(0.995, gt=0, le=1, description="discount factor (Table 4.3)")
    max_steps: Count | None = Field(
        None, description="cap on steps; None = ten times the sum of the sides (section 4.2.2: 400, 450)"
    )


class TaskSettings(RewardSettings):
    """What a flight earns, when it ends and between which cells it leads (section 4.2.2)."""

    start: Cell | None = Field(None, description="fixed start IX IY IZ; None = drawn uniformly")
    goal: Cell | None = Field(None, description="fixed goal IX IY IZ; None = drawn uniformly")


ALGORITHM_HELP = "ddqn-her (as published) or fqi-her (near-exact); given with --help, the settings shown are its own"


class LearnerSettings(Settings):
    """The published learner DDQN-HER (section 4.3)."""

    algorithm: Literal["ddqn-her"] = Field("ddqn-her", description=ALGORITHM_HELP)
    episodes: Count = Field(30_000, description="number of episodes N (Table 4.3: 30,000 in 2D, 50,000 in 3D)")
    batch_size: Count = Field(32, description="mini-batch size (Table 4.3)")
    replay_capacity: int = Field(
        500_000, ge=1, le=100_000_000, description="experiences in the replay memory, hindsight included (Table 4.3)"
    )
    replay_start: Count = Field(50_000, description="random experiences M before learning, hindsight included (Table 4.3)")
    updates_per_episode: Count = Field(30, description="optimization steps after each episode (Table 4.3)")
    target_period: Count = Field(10, description="episodes between renewals of the target network C (Table 4.3)")
    learning_rate: Positive = Field(1e-3, description="learning rate of Adam (Table 4.3)")
    exploration: Literal["boltzmann", "epsilon-greedy"] = Field("boltzmann", description="exploration (section 3.1.6)")
    initial_exploration: NonNegative = Field(2.0, description="initial temperature, or epsilon (Table 4.3)")
    final_exploration: NonNegative = Field(0.1, description="final temperature, or epsilon (Table 4.3)")
    exploration_fraction: float = Field(0.5, gt=0, le=1, description="share of episodes of the descent (Table 4.3: 0.5, 3D 0.7)")
    hindsight: bool = Field(True, description="hindsight experience replay on or off (section 5.4)")
    hindsight_ratio: Count = Field(2, description="hindsight goals stored beside each own experience, k (Table 4.3)")
    hindsight_strategy: Literal["future", "final", "episode"] = Field("future", description="hindsight goals (section 3.3.4)")
    double: bool = Field(True, description="double Q-learning on or off (section 5.4)")
    clip_targets: bool = Field(True, description="clip targets to what a flight can earn (ours: without it some seeds diverge)")
    architecture: Literal["concatenated", "two-stream", "dueling"] = Field(
        "concatenated", description="value network (section 3.3.3; dueling: Wang et al. 2016)"
    )
    hidden_layers: Count = Field(3, description="hidden layers (section 4.3)")
    hidden_units: Count = Field(50, description="units of each hidden layer (section 4.3)")
    n_steps: Count = Field(1, le=100, description="steps of the return in a target (Sutton 1988; thesis: 1)")
    prioritised: bool = Field(False, description="prioritised replay, proportional, on or off (Schaul et al. 2016; thesis: off)")
    priority_exponent: float = Field(0.6, gt=0, le=1, description="exponent of priorities, alpha (Schaul et al. 2016)")
    importance_exponent: float = Field(
        0.4, ge=0, le=1, description="first exponent of the importance weights, beta; the last is 1 (Schaul et al. 2016)"
    )
    networks: Count = Field(1, le=2, description="networks; of 2 the smaller value makes the target (Fujimoto et al. 2018)")

    @model_validator(mode="after")
    def _consistent(self) -> "LearnerSettings":
        if self.replay_start > self.replay_capacity:
            raise ValueError(f"replay_start {self.replay_start} is larger than replay_capacity {self.replay_capacity}; lower it")
        if self.exploration == "epsilon-greedy" and max(self.initial_exploration, self.final_exploration) > 1:
            raise ValueError("epsilon-greedy needs initial_exploration and final_exploration between 0 and 1")
        return self


class PairLearnerSettings(Settings):
    """The near-exact learner FQI-HER: fitted Q-iteration over pairs of cells (docs/learning.md)."""

    algorithm: Literal["fqi-her"] = Field("fqi-her", description=ALGORITHM_HELP)
    rounds: Count = Field(FQIHER.rounds, description="rounds; in each all flights fly some steps, then the network is fitted")
    flights: Count = Field(FQIHER.flights, description="flights in the air at a time")
    steps_per_round: Count = Field(FQIHER.steps_per_round, description="steps of each flight in a round")
    updates_per_round: Count = Field(FQIHER.updates_per_round, description="optimization steps in a round")
    batch_size: Count = Field(FQIHER.batch_size, description="pairs of cell and goal in a mini-batch")
    goals_per_round: Count = Field(FQIHER.goals_per_round, description="hindsight goals whose targets are computed in a round")
    sweeps: Count = Field(
        FQIHER.sweeps, description="known moves with the learned penalty before the network takes over in a target"
    )
    penalty_model: bool = Field(FQIHER.penalty_model, description="learn the chance of low signal per cell; off = model-free")
    look_ahead: Count = Field(
        FQIHER.look_ahead, description="moves the policy looks ahead through the penalty model before its network"
    )
    prioritised: float = Field(
        FQIHER.prioritised, ge=0, le=1, description="share of a mini-batch drawn in proportion to its error"
    )
    near: float = Field(FQIHER.near, ge=0, le=1, description="share of a mini-batch drawn from cells near the goal")
    near_cells: Count = Field(FQIHER.near_cells, description="how near: at most so many cells away along each axis")
    cached_goals: Count = Field(
        FQIHER.cached_goals, description="goals whose targets are kept for fitting, the oldest renewed first"
    )
    networks: Count = Field(FQIHER.networks, le=8, description="networks of which the least value counts (2 = clipped double Q)")
    hidden_units: Count = Field(FQIHER.hidden_units, description="units of the hidden layers")
    learning_rate: Positive = Field(FQIHER.learning_rate, description="learning rate of Adam in the first round")
    final_learning_rate: Positive = Field(
        FQIHER.final_learning_rate, description="learning rate of Adam in the last round, by half a cosine"
    )
    averaging: float = Field(
        FQIHER.averaging, gt=0, le=1, description="share of the new weights in the averaged network at each update"
    )
    initial_exploration: NonNegative = Field(FQIHER.initial_exploration, description="initial temperature")
    final_exploration: NonNegative = Field(FQIHER.final_exploration, description="final temperature")
    exploration_fraction: float = Field(FQIHER.exploration_fraction, gt=0, le=1, description="share of rounds of the descent")
    count_bonus: NonNegative = Field(
        FQIHER.count_bonus, description="bonus of entering a cell, over the root of how often it was measured"
    )
    stored_per_cell: Count = Field(FQIHER.stored_per_cell, description="measurements of each cell kept for replay (model-free)")

    @model_validator(mode="after")
    def _consistent(self) -> "PairLearnerSettings":
        if self.prioritised + self.near > 1:
            raise ValueError(f"prioritised {self.prioritised:g} and near {self.near:g} add up to more than 1; lower one")
        if not self.penalty_model and self.look_ahead > 1:
            raise ValueError(f"without penalty_model no move can be looked through; set look_ahead, now {self.look_ahead}, to 1")
        return self


AnyLearnerSettings = LearnerSettings | PairLearnerSettings
LEARNERS: dict[str, type[LearnerSettings] | type[PairLearnerSettings]] = {
    "ddqn-her": LearnerSettings,
    "fqi-her": PairLearnerSettings,
}
"""Settings by the name of the algorithm."""


class EvaluationSettings(Settings):
    """How policies are compared (section 4.4)."""

    n_sampled: Count = Field(10_000, description="sampled flights (section 4.4)")
    seed: int = Field(0, ge=0, description="seed of instances and noise")
    boltzmann_temperature: Positive = Field(0.1, description="temperature of the stochastic learned policy")
    max_exhaustive_pairs: Annotated[int, Field(ge=0)] = Field(5_000_000, description="fly all pairs exactly below this number")


MapSettings = SimulatedMap | MeasuredMap | MapFile


class Scenario(Settings):
    """One experiment."""

    name: str = Field("scenario", description="name in tables and files")
    map: MapSettings = Field(SimulatedMap(), discriminator="kind")
    task: TaskSettings = TaskSettings()
    learner: AnyLearnerSettings = Field(LearnerSettings(), discriminator="algorithm")
    evaluation: EvaluationSettings = EvaluationSettings()


SHIPPED = Path(__file__).parent / "scenarios"


def find_scenario(name: str) -> Path:
    """The file of that path, or the shipped scenario of that name; `InputError` if there is neither."""
    path = Path(name)
    if path.is_file():
        return path
    shipped = sorted(p.stem for p in SHIPPED.glob("*.toml"))
    if name in shipped:
        return SHIPPED / f"{name}.toml"
    raise InputError(f"{name}: no such scenario file; expected a TOML file or one of {', '.join(shipped)}")


def load_scenario(path: Path) -> Scenario:
    """Read a scenario; `InputError` names the file, the line and the field of what is wrong.

    Relative paths in it are relative to the working directory, as on the command line.
    """
    if not path.is_file():
        raise InputError(f"{path}: no such scenario file")
    try:
        text = path.read_text(encoding="utf-8")
        data = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: not valid TOML: {error}") from error
    if not data:
        raise InputError(f"{path}: the file is empty; expected sections map, task, learner, evaluation")
    data.setdefault("name", path.stem)
    if isinstance(data.get("map"), dict):
        data["map"].setdefault("kind", "simulated")
    if isinstance(data.get("learner"), dict):
        data["learner"].setdefault("algorithm", "ddqn-her")
    return validated(Scenario, data, str(path), text)


def validated(model: type[Scenario], data: dict[str, Any], where: str, text: str = "") -> Scenario:
    """`model` built from data; the first problem becomes a one-line `InputError`."""
    try:
        return model.model_validate(data)
    except ValidationError as error:
        raise InputError(describe(error, where, text)) from error


def describe(error: ValidationError, where: str, text: str = "") -> str:
    """One line for the first problem of a pydantic error: file and line, field, what was found, what was expected."""
    first = error.errors(include_url=False)[0]
    keys = [str(key) for key in first["loc"] if str(key) not in ("simulated", "measured", "file", *LEARNERS)]
    line = _line_of(keys, text)
    place = f"{where}:{line}" if line else where
    field = ".".join(keys) or "settings"
    if first["type"] == "extra_forbidden":
        return f"{place}: unknown key {field}; see cellpilot run --help for the settings"
    message = first["msg"].removeprefix("Value error, ").replace("Input should", "should")
    found = "" if first["type"] == "value_error" else f" is {first['input']!r}"
    return f"{place}: {field}{found}: {message[0].lower()}{message[1:]}"


def _line_of(keys: list[str], text: str) -> int | None:
    """Line of the field `keys`, counted from 1: its own line, that of a table it stands in, or of its section."""
    section: list[str] = []
    best, longest = None, 0
    for number, line in enumerate(text.splitlines(), 1):
        if header := re.match(r"\s*\[\s*([\w.-]+)\s*\]", line):
            section = here = header[1].split(".")
        elif key := re.match(r"\s*([\w.-]+)\s*=", line):
            here = section + key[1].split(".")
        else:
            continue
        if here == keys[: len(here)] and len(here) > longest:
            best, longest = number, len(here)
    return best


def dump_scenario(scenario: Scenario) -> str:
    """The scenario as TOML text that `load_scenario` reads back equal."""
    lines = [f"name = {_toml(scenario.name)}"]
    for section, values in scenario.model_dump(mode="json").items():
        if isinstance(values, dict):
            lines += ["", f"[{section}]"]
            lines += [f"{key} = {_toml(value)}" for key, value in values.items() if value is not None]
    return "\n".join(lines) + "\n"


def _toml(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")
    if isinstance(value, list):
        return "[" + ", ".join(_toml(item) for item in value) + "]"
    return repr(value)
