"""The verbs as functions: plain data in, plain data out. The command line, notebooks and pages call the same ones.

Nothing here prints. Long work tells `progress` the share that is done (0..1), and `warn` hears sentences about results that
are hardly what was wanted; without it they are Python warnings. Errors (`cellpilot.InputError`) name arguments in backquotes.
"""

from cellpilot.lazy import loader

_HOMES = {
    "adapting": ("AdaptSettings", "Adapted", "adapt"),
    "evaluating": ("Evaluated", "evaluate"),
    "exporting": ("export_policy", "exports"),
    "planning": ("Planned", "plan"),
    "reporting": ("report",),
    "sources": ("Source", "load_run", "open_source"),
    "training": ("Trained", "resume", "train"),
}

__all__ = sorted(name for names in _HOMES.values() for name in names)
__getattr__, __dir__ = loader(__name__, _HOMES)
