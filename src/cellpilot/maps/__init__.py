"""Radio maps: their schema, files, gridding, estimates and sources. Names are loaded when they are first used."""

from typing import TYPE_CHECKING

from cellpilot.lazy import loader

if TYPE_CHECKING:
    from cellpilot.maps.account import ImportAccount, LevelAccount, LogAccount, account_of
    from cellpilot.maps.estimate.fill import fill
    from cellpilot.maps.files import load_map, save_map
    from cellpilot.maps.geodesy import Anchor, to_degrees, to_local
    from cellpilot.maps.gridding import Bins, grid_samples
    from cellpilot.maps.samples import Samples
    from cellpilot.maps.schema import RadioMap, anchor_of, grid_of, make_map, validate
    from cellpilot.maps.sources.logs import LogOptions, read_log
    from cellpilot.maps.sources.measured_log import import_logs
    from cellpilot.maps.sources.opencellid import AssumedSectors, read_opencellid
    from cellpilot.maps.sources.simulated import simulate_map
    from cellpilot.maps.sources.sites import SiteList, read_sites, write_sites

__all__ = [
    "Anchor",
    "AssumedSectors",
    "Bins",
    "ImportAccount",
    "LevelAccount",
    "LogAccount",
    "LogOptions",
    "RadioMap",
    "Samples",
    "SiteList",
    "account_of",
    "anchor_of",
    "fill",
    "grid_of",
    "grid_samples",
    "import_logs",
    "load_map",
    "make_map",
    "read_log",
    "read_opencellid",
    "read_sites",
    "save_map",
    "simulate_map",
    "to_degrees",
    "to_local",
    "validate",
    "write_sites",
]

# Importing xarray takes most of the half second the command line may need to show its help.
_HOMES = {
    "account": ("ImportAccount", "LevelAccount", "LogAccount", "account_of"),
    "estimate.fill": ("fill",),
    "files": ("load_map", "save_map"),
    "geodesy": ("Anchor", "to_degrees", "to_local"),
    "gridding": ("Bins", "grid_samples"),
    "schema": ("RadioMap", "anchor_of", "grid_of", "make_map", "validate"),
    "samples": ("Samples",),
    "sources.logs": ("LogOptions", "read_log"),
    "sources.measured_log": ("import_logs",),
    "sources.opencellid": ("AssumedSectors", "read_opencellid"),
    "sources.simulated": ("simulate_map",),
    "sources.sites": ("SiteList", "read_sites", "write_sites"),
}
__getattr__, __dir__ = loader(__name__, _HOMES)
