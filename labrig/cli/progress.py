"""Progress of a run or a batch: a bar with elapsed and remaining time on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import IO, Any, TypeAlias, cast

from labrig.cli.output import SafeStandardError, escape_controls, say
from labrig.devices.clocks import SystemClock
from labrig.text import duration

Reporter: TypeAlias = Callable[[float, str], None]
"""Takes how much of the total is done, in its unit, and what is being done."""

_shown: list[Any] = []
"""The rich bar on the terminal, if one is shown."""


@contextmanager
def progress(title: str, total: float) -> Iterator[Reporter]:
    """Show progress on standard error; `total` is in seconds of rig time, or in pictures."""
    if not sys.stderr.isatty():
        yield _PlainLines(title, total)
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    columns = (
        TextColumn("{task.percentage:>3.0f} %"),
        BarColumn(12),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", ratio=1),
        ),
    )
    with Progress(*columns, console=_make_console(), expand=True) as bar:
        task = bar.add_task(escape_controls(title), total=total)
        _shown.append(bar)
        try:
            yield lambda done, doing: bar.update(task, completed=done, description=escape_controls(doing))
        finally:
            _shown.remove(bar)


@contextmanager
def show_working(title: str) -> Iterator[None]:
    """Show on a terminal that the block is at work, until its end; elsewhere nothing."""
    if not sys.stderr.isatty():
        yield
        return
    with _make_console().status(escape_controls(title)):
        yield


@contextmanager
def hold_bar() -> Iterator[None]:
    """Take the bar off the terminal during the block, so that it stands beside no question and no answer."""
    for bar in _shown:
        bar.live.transient = True  # leaves nothing
        bar.stop()
        bar.live.transient = False
    try:
        yield
    finally:
        for bar in _shown:
            bar.start()


def _make_console() -> Any:
    from rich.console import Console

    return Console(file=cast("IO[str]", SafeStandardError()))


_LEAST_PAUSE_S = 2.0


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
        if int(10 * fraction) <= self._tenths or elapsed_s < self._printed_s + _LEAST_PAUSE_S:
            return
        self._tenths, self._printed_s = int(10 * fraction), elapsed_s
        times = f"{duration(elapsed_s)} elapsed, about {duration(elapsed_s * (1 - fraction) / fraction)} left"
        say(f"{self._title}: {100 * fraction:3.0f} %, {times} ({doing})")
