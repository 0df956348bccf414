"""Radio maps: their schema, files, gridding, estimates and sources. Names are loaded when they are first used."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellpilot.maps.account import ImportAccount, LevelAccount, LogAccount, account_of
    from cellpilot.maps.estimate.neighbours import fill
    from cellpilot.maps.files import load_map, save_map
    from cellpilot.maps.geodesy import Anchor, to_degrees, to_local
    from cellpilot.maps.gridding import Bins, grid_samples
    from cellpilot.maps.schema import RadioMap, anchor_of, grid_of, make_map, validate
    from cellpilot.maps.sources.measured_log import LogTable, import_logs, read_log
    from cellpilot.maps.sources.simulated import simulate_map

__all__ = [
    "Anchor",
    "Bins",
    "ImportAccount",
    "LevelAccount",
    "LogAccount",
    "LogTable",
    "RadioMap",
    "account_of",
    "anchor_of",
    "fill",
    "grid_of",
    "grid_samples",
    "import_logs",
    "load_map",
    "make_map",
    "read_log",
    "save_map",
    "simulate_map",
    "to_degrees",
    "to_local",
    "validate",
]

# Importing xarray takes most of the half second the command line may need to show its help.
_HOME = {
    "account": ("ImportAccount", "LevelAccount", "LogAccount", "account_of"),
    "estimate.neighbours": ("fill",),
    "files": ("load_map", "save_map"),
    "geodesy": ("Anchor", "to_degrees", "to_local"),
    "gridding": ("Bins", "grid_samples"),
    "schema": ("RadioMap", "anchor_of", "grid_of", "make_map", "validate"),
    "sources.measured_log": ("LogTable", "import_logs", "read_log"),
    "sources.simulated": ("simulate_map",),
}
_MODULE_OF = {name: module for module, names in _HOME.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
