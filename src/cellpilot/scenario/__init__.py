"""`Scenario` = map + task + learner + evaluation. TOML files and command-line flags are two views of it.

Every value of the thesis is a default here, with its table or section. Unknown keys are refused.
"""

from cellpilot.maps.settings import LogSettings
from cellpilot.scenario.learner import LEARNERS, PUBLISHED_LEARNER, AnyLearner
from cellpilot.scenario.maps import MapFile, MapSettings, MeasuredMap, SimulatedMap
from cellpilot.scenario.task import AirspaceSettings, EvaluationSettings, RewardSettings, TaskSettings
from cellpilot.scenario.toml import SHIPPED, Scenario, describe, dump_scenario, find_scenario, load_scenario, one_name, validated
from cellpilot.settings import Cell, Count, Finite, Floats, NonNegative, Pair, Paths, Positive, Settings

__all__ = [
    "LEARNERS",
    "PUBLISHED_LEARNER",
    "SHIPPED",
    "AirspaceSettings",
    "AnyLearner",
    "Cell",
    "Count",
    "EvaluationSettings",
    "Finite",
    "Floats",
    "LogSettings",
    "MapFile",
    "MapSettings",
    "MeasuredMap",
    "NonNegative",
    "Pair",
    "Paths",
    "Positive",
    "RewardSettings",
    "Scenario",
    "Settings",
    "SimulatedMap",
    "TaskSettings",
    "describe",
    "dump_scenario",
    "find_scenario",
    "load_scenario",
    "one_name",
    "validated",
]
