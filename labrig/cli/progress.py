"""Progress of a run or a batch: a bar with elapsed and remaining time on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import IO, Protocol, cast

from labrig.cli.output import SafeStandardError, escape_controls, say
from labrig.devices.clocks import SystemClock


class Reporter(Protocol):
    """Takes how much of the total is done, and what is being done."""

    def __call__(self, done: float, doing: str) -> None:
        """Take `done`, in the unit of the total, and a short sentence."""
        ...


@contextmanager
def progress(title: str, total: float) -> Iterator[Reporter]:
    """Show progress on standard error; `total` is in seconds of rig time, or in pictures."""
    if sys.stderr.isatty():
        with _show_bar(title, total) as reporter:
            yield reporter
    else:
        yield _PlainLines(title, total)


_LEAST_BAR_COLUMNS = 70
"""Columns that bar, times and description need; a narrower terminal gets no bar."""


@contextmanager
def _show_bar(title: str, total: float) -> Iterator[Reporter]:
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    console = Console(file=cast("IO[str]", SafeStandardError()))
    columns = (
        (
            TextColumn(
                "{task.percentage:>3.0f} % {task.description}",
                markup=False,
                table_column=Column(no_wrap=True, overflow="ellipsis"),
            ),
        )
        if console.width < _LEAST_BAR_COLUMNS
        else (
            TextColumn("{task.percentage:>3.0f} %"),
            BarColumn(bar_width=None),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            TextColumn("{task.description}", markup=False),
        )
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(escape_controls(title), total=total)

        def report(done: float, doing: str) -> None:
            bar.update(task, completed=done, description=escape_controls(doing))

        yield report


LEAST_PAUSE_S = 2.0


class _PlainLines:
    """A line at each tenth of the total, at least two seconds apart, with elapsed and remaining time."""

    def __init__(self, title: str, total: float) -> None:
        self._title = title
        self._total = max(total, 1e-9)
        self._clock = SystemClock()
        self._tenths = 0
        self._printed_s = 0.0

    def __call__(self, done: float, doing: str) -> None:
        fraction = min(done / self._total, 1.0)
        elapsed_s = self._clock.now_s()
        if int(10 * fraction) <= self._tenths or elapsed_s < self._printed_s + LEAST_PAUSE_S:
            return
        self._tenths, self._printed_s = int(10 * fraction), elapsed_s
        remaining_s = elapsed_s * (1 - fraction) / fraction
        times = f"{elapsed_s:.0f} s elapsed, about {remaining_s:.0f} s left"
        say(f"{self._title}: {100 * fraction:3.0f} %, {times} ({doing})")
