"""What a person sees: tables on standard output, progress and warnings on standard error."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    Progress,
    ProgressColumn,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)

PLAIN_WIDTH = 120
"""Characters in a line where standard output is no terminal: tables keep all their digits in a pipe or a log."""

if TYPE_CHECKING:
    from cellpilot.learn.trainer import TrainingProgress

out = Console(highlight=False, markup=False, soft_wrap=True, width=None if sys.stdout.isatty() else PLAIN_WIDTH)
err = Console(stderr=True, highlight=False, markup=False, soft_wrap=True)


def warn(message: str | None) -> None:
    """Print a warning, if there is one."""
    if message:
        err.print(f"warning: {message}", style="yellow")


@contextmanager
def _bar(*columns: ProgressColumn) -> Iterator[Progress]:
    """A bar on a terminal only; an error takes it away, so that one line of message is all that is left."""
    with Progress(*columns, console=err, refresh_per_second=2, disable=not err.is_terminal) as bar:
        try:
            yield bar
        except BaseException:
            bar.live.transient = True
            raise


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
    with _bar(*columns) as bar:
        task = bar.add_task("train", total=rounds, rate="", facts="compiling")

        def show(progress: "TrainingProgress") -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:,.0f} {counts}/s" if speed else ""
            known = progress.return_mean == progress.return_mean  # NaN: no flight has ended
            means = f"return {progress.return_mean:+.2f}  reached {progress.reached_share:.1%}" if known else "no flight ended"
            facts = f"{means}  {explores} {progress.exploration:.2f}"
            bar.update(task, completed=progress.done, rate=rate, facts=facts)

        yield show


@contextmanager
def share_bar(title: str) -> Iterator[Callable[[float], None]]:
    """A bar for anything that knows the share done (0..1)."""
    columns = (TextColumn(title), BarColumn(bar_width=24), TextColumn("{task.percentage:>3.0f} %"), TimeElapsedColumn())
    with _bar(*columns, TextColumn("left"), TimeRemainingColumn()) as bar:
        task = bar.add_task(title, total=1.0)
        yield lambda share: bar.update(task, completed=share)
