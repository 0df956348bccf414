"""Reports: the figures, the tables and the self-contained page of one run."""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from cellpilot.report.report import write_report
    from cellpilot.report.tables import text_table

__all__ = ["text_table", "write_report"]

# Matplotlib is slow to import, and the command line shows its help without it.
_MODULE_OF = {"text_table": "tables", "write_report": "report"}


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_MODULE_OF[name]}"), name)
