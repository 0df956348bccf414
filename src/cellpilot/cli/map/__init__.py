"""`cellpilot map ACTION`: radio maps without any learning, one thin file for each action."""

from collections.abc import Sequence
from importlib import import_module

from cellpilot.cli.console import out
from cellpilot.errors import InputError

ACTIONS = {
    "simulate": ("simulate", "simulate a deployment or a site list"),
    "sites": ("sites", "write a site list: of a scenario's deployment, or from OpenCelliD"),
    "import": ("import_logs", "grid measured logs; --holdout checks how well holes are filled"),
    "calibrate": ("calibrate", "shift and stretch a simulated map to measurements"),
    "raytrace": ("raytrace", "trace rays through a city (extra raytrace)"),
    "convert": ("convert", "NetCDF, Zarr, GeoTIFF and CSV into one another"),
    "info": ("info", "what a map holds, in words"),
    "show": ("show", "draw a map: SINR, chance of low SINR, serving sectors, spread, distribution"),
    "compare": ("compare", "two maps of one grid: difference, correlation, agreement on the threshold"),
    "antenna": ("antenna", "draw both cuts of an antenna file"),
}
"""Module and description of each action."""


def main(arguments: Sequence[str]) -> int:
    """Verb `map`: finds the action."""
    if not arguments or arguments[0] in ("-h", "--help"):
        out.print("usage: cellpilot map ACTION ...      (cellpilot map ACTION --help for its options)\n")
        for action, (_, text) in ACTIONS.items():
            out.print(f"  {action:<12} {text}")
        return 0
    if arguments[0] not in ACTIONS:
        raise InputError(f"unknown action {arguments[0]!r}; expected one of {', '.join(ACTIONS)} (cellpilot map --help)")
    module, _ = ACTIONS[arguments[0]]
    return int(import_module(f"cellpilot.cli.map.{module}").main(arguments[1:]))
