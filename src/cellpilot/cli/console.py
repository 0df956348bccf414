"""What a person sees: tables on standard output, progress and warnings on standard error."""

import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from rich.console import Console, ConsoleOptions, RenderableType
from rich.measure import Measurement
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

from cellpilot.text import as_flags, encodable, visible

PLAIN_WIDTH = 120
"""Characters in a line where standard output is no terminal: tables keep all their digits in a pipe or a log."""
LINE_EVERY_S = 30.0
"""Where there is no terminal, long work says so often how far it is."""

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress


class SafeConsole(Console):
    """A console whose text does nothing to a terminal, is in letters that the stream has, and whose tables keep their digits."""

    def print(self, *objects: Any, **options: Any) -> None:
        """As in Rich; a table that is wider than the terminal is printed row by row."""
        super().print(*(self._narrow(item) if isinstance(item, Table) else item for item in objects), **options)

    def on_broken_pipe(self) -> None:
        """Whoever reads the output has gone: `cli.main` ends the command, with its usual exit code."""
        raise

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        """The segments of Rich, their text made safe."""
        for segment in super().render(renderable, options):
            if segment.control:
                yield segment
            else:
                yield Segment(encodable(visible(segment.text), self.encoding), segment.style)

    def _narrow(self, table: Table) -> RenderableType:
        if Measurement.get(self, self.options.update(max_width=10_000), table).maximum <= self.width:
            return table
        return Text("\n".join(stacked(table)), overflow="fold")


class _Messages(SafeConsole):
    """Standard error: what a closed terminal or a full disk does not take is dropped, and the work goes on."""

    def _check_buffer(self) -> None:
        try:
            super()._check_buffer()
        except OSError:
            del self._buffer[:]


def stacked(table: Table) -> list[str]:
    """A table as lines: its title, and for each row the first cell, then heading and cell of every other column."""
    headings = [_plain(column.header) for column in table.columns]
    cells = [[_plain(cell) for cell in column.cells] for column in table.columns]
    lines = [_plain(table.title)] if table.title else []
    for row in zip(*cells, strict=True):
        lines += ["", row[0], *(f"  {heading}: {cell}" for heading, cell in zip(headings[1:], row[1:], strict=True))]
    return [*lines, *(["", _plain(table.caption)] if table.caption else [])]


def _plain(cell: RenderableType | None) -> str:
    return cell.plain if isinstance(cell, Text) else str(cell)


def _terminal_width() -> int | None:
    return None if sys.stdout is not None and sys.stdout.isatty() else PLAIN_WIDTH


out = SafeConsole(highlight=False, markup=False, soft_wrap=True, width=_terminal_width())
err = _Messages(stderr=True, highlight=False, markup=False, soft_wrap=True)


def warn(message: str | None) -> None:
    """Print a warning, if there is one."""
    if message:
        err.print(f"warning: {as_flags(message)}", style="yellow")


@contextmanager
def _bar(*columns: ProgressColumn) -> Iterator[Progress]:
    """A bar on a terminal only; an error takes it away, so that one line of message is all that is left."""
    with Progress(*columns, console=err, refresh_per_second=2, disable=not err.is_terminal) as bar:
        try:
            yield bar
        except BaseException:
            bar.live.transient = True
            raise


class _Lines:
    """Where there is no terminal: a line now and then about the share that is done and the time left."""

    def __init__(self, title: str) -> None:
        self._title, self._started, self._last = title, time.monotonic(), time.monotonic()

    def show(self, share: float, facts: str = "") -> None:
        """Print a line if the last one was long ago."""
        now = time.monotonic()
        if err.is_terminal or now - self._last < LINE_EVERY_S:
            return
        self._last = now
        left_s = (now - self._started) * (1 - share) / share if share > 0 else None
        left = "" if left_s is None else f", about {left_s / 60:.0f} min left" if left_s >= 90 else f", about {left_s:.0f} s left"
        err.print(f"{self._title}: {share:.0%} done{left}{', ' if facts else ''}{facts}")


@contextmanager
def training_bar(rounds: int, counts: str, explores: str) -> "Iterator[Callable[[TrainingProgress], None]]":
    """A bar with episodes (`counts` names them), rate, time left, return, share reached and exploration (`explores`)."""
    columns = (
        TextColumn("train"),
        BarColumn(bar_width=24),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn("{task.fields[facts]}"),
    )
    lines = _Lines("train")
    with _bar(*columns) as bar:
        task = bar.add_task("train", total=rounds, rate="", facts="compiling")

        def show(progress: "TrainingProgress") -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:,.0f} {counts}/s" if speed else ""
            known = progress.return_mean == progress.return_mean  # NaN: no flight has ended
            means = f"return {progress.return_mean:+.2f}  reached {progress.reached_share:.1%}" if known else "no flight ended"
            facts = f"{means}  {explores} {progress.exploration:.2f}"
            bar.update(task, completed=progress.done, rate=rate, facts=facts)
            lines.show(progress.done / progress.rounds, f"{progress.done:,} of {progress.rounds:,} {counts}, {means}")

        yield show


@contextmanager
def share_bar(title: str) -> Iterator[Callable[[float], None]]:
    """A bar for anything that knows the share done (0..1)."""
    columns = (TextColumn(title), BarColumn(bar_width=24), TextColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn())
    lines = _Lines(title)
    with _bar(*columns, TextColumn("left"), TimeRemainingColumn()) as bar:
        task = bar.add_task(title, total=1.0)

        def show(share: float) -> None:
            bar.update(task, completed=share)
            lines.show(share)

        yield show
