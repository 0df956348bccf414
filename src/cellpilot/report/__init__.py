"""Reports: the figures, the tables and the self-contained page of one run."""

from typing import TYPE_CHECKING

from cellpilot.lazy import loader

if TYPE_CHECKING:
    from cellpilot.report.report import write_report
    from cellpilot.report.tables import text_table

__all__ = ["text_table", "write_report"]

# Matplotlib is slow to import, and the command line shows its help without it.
__getattr__, __dir__ = loader(__name__, {"report": ("write_report",), "tables": ("text_table",)})
