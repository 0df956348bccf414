"""What would be received at (x, y, z): propagation, antennas, deployment, shadowing, SINR. NumPy only."""

from cellpilot.radio.antenna import Antenna, ColumnAntenna, element_gain_dbi
from cellpilot.radio.antenna_file import AntennaFile, read_antenna, write_antenna
from cellpilot.radio.antenna_pattern import PatternAntenna
from cellpilot.radio.deployment import Deployment, hexagonal_deployment
from cellpilot.radio.interference import RESOURCE_BLOCKS, Interference
from cellpilot.radio.propagation import ENVIRONMENTS, los_probability, path_loss_db, shadow_std_db
from cellpilot.radio.settings import ColumnSettings, EnvironmentName, HexagonalSettings, LosMode, PropagationSettings
from cellpilot.radio.simulation import Reception, received_power_dbm, simulate

__all__ = [
    "ENVIRONMENTS",
    "RESOURCE_BLOCKS",
    "Antenna",
    "AntennaFile",
    "ColumnAntenna",
    "ColumnSettings",
    "Deployment",
    "EnvironmentName",
    "HexagonalSettings",
    "Interference",
    "LosMode",
    "PatternAntenna",
    "PropagationSettings",
    "Reception",
    "element_gain_dbi",
    "hexagonal_deployment",
    "los_probability",
    "path_loss_db",
    "read_antenna",
    "received_power_dbm",
    "shadow_std_db",
    "simulate",
    "write_antenna",
]
