"""Progress of a run or a batch: a bar with elapsed and remaining time on a terminal, plain lines elsewhere."""

import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from typing import IO, Any, Protocol, TypeAlias, cast

from labrig.cli.output import SafeStandardError, escape_controls, say
from labrig.clock import Clock
from labrig.devices.clocks import SystemClock


class Reporter(Protocol):
    """Takes how much of the total is done, and what is being done."""

    def __call__(self, done: float, doing: str) -> None:
        """Take `done`, in the unit of the total, and a short sentence."""
        ...


ShareReporter: TypeAlias = Callable[[float], None]
"""Takes the share that is done, 0 to 1."""


@contextmanager
def progress(title: str, total: float) -> Iterator[Reporter]:
    """Show progress on standard error; `total` is in seconds of rig time, or in pictures."""
    if sys.stderr.isatty():
        with _show_bar(title, total) as reporter:
            yield reporter
    else:
        yield _PlainLines(title, total)


_PATIENCE_S = 0.5
"""How long nothing is shown of work that is usually short."""


@contextmanager
def progress_if_slow(title: str, clock: Clock, *, shown: bool) -> Iterator[ShareReporter]:
    """Show a bar on a terminal once the clock is at half a second, and remove it at the end; elsewhere nothing."""
    with ExitStack() as stack:
        bars: list[Reporter] = []

        def report(share: float) -> None:
            if not bars and clock.now_s() >= _PATIENCE_S:
                bars.append(stack.enter_context(_show_bar(title, 1.0, transient=True)))
            for bar in bars:
                bar(share, title)

        yield report if shown and sys.stderr.isatty() else _report_nothing


_LONG_S = 1.0
"""How long nothing is shown of work whose length is not known."""


@contextmanager
def show_working(title: str, *, shown: bool, patience_s: float = _LONG_S) -> Iterator[None]:
    """Show on a terminal that the block is at work once it has taken so long, until its end; elsewhere nothing."""
    if not (shown and sys.stderr.isatty()):
        yield
        return
    done = threading.Event()

    def watch() -> None:
        if not done.wait(patience_s):
            with _show_bar(title, None, transient=True):
                done.wait()

    watcher = threading.Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        done.set()
        watcher.join()


def _report_nothing(share: float) -> None:
    """Take the place of a bar."""


class _Bar(Protocol):
    @property
    def live(self) -> Any: ...

    def start(self) -> None: ...

    def stop(self) -> None: ...


_shown: list[_Bar] = []
"""The bar on the terminal, if one is shown."""


@contextmanager
def hold_bar() -> Iterator[None]:
    """Take the bar off the terminal during the block, so that it stands beside no question and no answer."""
    for bar in _shown:
        _remove(bar)
    try:
        yield
    finally:
        for bar in _shown:
            bar.start()


def _remove(bar: _Bar) -> None:
    """Stop a bar and leave nothing of it, whether or not it stays in the end."""
    transient = bar.live.transient
    bar.live.transient = True
    bar.stop()
    bar.live.transient = transient


_LEAST_BAR_COLUMNS = 70
"""Columns that bar, times and description need; a narrower terminal gets no bar."""

_BAR_AND_TIMES_COLUMNS = 40
"""What a description leaves to percentage, bar and times, so that none of them is cut."""


@contextmanager
def _show_bar(title: str, total: float | None, *, transient: bool = False) -> Iterator[Reporter]:
    """Show a bar; without a total, only that time passes."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(file=cast("IO[str]", SafeStandardError()))
    columns = _list_columns(console.width, counted=total is not None)
    with Progress(*columns, console=console, transient=transient) as bar:
        task = bar.add_task(escape_controls(title), total=total)

        def report(done: float, doing: str) -> None:
            bar.update(task, completed=done, description=escape_controls(doing))

        _shown.append(bar)
        try:
            yield report
        finally:
            _shown.remove(bar)


def _list_columns(width: int, *, counted: bool) -> tuple[Any, ...]:
    """Return rich's columns of a bar on a terminal so wide; it is imported only where a bar is shown."""
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.table import Column

    if not counted:
        return SpinnerColumn(), TextColumn("{task.description}", markup=False), TimeElapsedColumn()
    if width < _LEAST_BAR_COLUMNS:
        return (
            TextColumn(
                "{task.percentage:>3.0f} % {task.description}",
                markup=False,
                table_column=Column(no_wrap=True, overflow="ellipsis"),
            ),
        )
    most = width - _BAR_AND_TIMES_COLUMNS
    return (
        TextColumn("{task.percentage:>3.0f} %"),
        BarColumn(bar_width=None),
        TimeElapsedColumn(),
        TextColumn("left"),
        TimeRemainingColumn(),
        TextColumn(
            "{task.description}",
            markup=False,
            table_column=Column(no_wrap=True, overflow="ellipsis", max_width=most),
        ),
    )


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
