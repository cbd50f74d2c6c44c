"""Progress of a run or a batch: a bar with elapsed and remaining time on a terminal, plain lines elsewhere."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import timedelta
from importlib import import_module
from typing import IO, Any, TypeAlias, cast

from labrig.cli.output import SafeStandardError, escape_controls, say
from labrig.devices.clocks import SystemClock
from labrig.text import duration

Reporter: TypeAlias = Callable[[float, str], None]
"""Takes how much of the total is done, in its unit, and what is being done."""

_TELLING_SHARE, _LEAST_PAUSE_S, _UNKNOWN = 0.02, 2.0, "-:--:--"

_shown: list[tuple[Any, "_Pace"]] = []
"""The rich bar on the terminal and its pace, if one is shown."""


class _Pace:
    """Tells the time left by how long the work lasts, or if that is not known by how fast all of it went so far.

    0 s are not known. Time in which a person was asked does not count.
    """

    def __init__(self, total: float, lasts_s: float) -> None:
        self._total, self._lasts_s, self._clock = max(total, 1e-9), lasts_s, SystemClock()
        self._held_s = self._share = self._spent_s = 0.0

    def now_s(self) -> float:
        """Return the time since the beginning [s]."""
        return self._clock.now_s()

    def leave_out(self, held_s: float) -> None:
        """Leave out a time in which nothing was done."""
        self._held_s += held_s

    def find_share(self, done: float) -> float:
        """Return how much of the whole is done."""
        return min(done / self._total, 1.0)

    def find_left_s(self, done: float) -> float | None:
        """Return the time left [s], which falls while one part is at work; None while too little is done to tell."""
        share, spent_s = self.find_share(done), self.now_s() - self._held_s
        if share > self._share:
            self._share, self._spent_s = share, spent_s
        lasts_s = self._lasts_s or (self._spent_s / share if share >= _TELLING_SHARE else None)
        return None if lasts_s is None else max(lasts_s - spent_s, 0.0)


def load_bar() -> None:
    """Load what draws the bar, before a rig is opened: until it is loaded nothing would watch the rig."""
    if sys.stderr.isatty():
        import_module("rich.progress")


@contextmanager
def progress(title: str, total: float, lasts_s: float = 0.0) -> Iterator[Reporter]:
    """Show progress on standard error; `total` is in calls of a rig, or in pictures; `lasts_s` as of `_Pace`."""
    if not sys.stderr.isatty():
        yield _PlainLines(title, _Pace(total, lasts_s))
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn
    from rich.table import Column

    one_line = Column(no_wrap=True, overflow="ellipsis", ratio=1)
    columns = (
        TextColumn("{task.percentage:>3.0f} %"),
        BarColumn(12),
        TimeElapsedColumn(),
        TextColumn("left {task.fields[left]}"),
        TextColumn("{task.description}", markup=False, table_column=one_line),
    )
    with Progress(*columns, console=_make_console(), expand=True) as bar:
        task, pace = bar.add_task(escape_controls(title), total=total, left=_UNKNOWN), _Pace(total, lasts_s)
        _shown.append((bar, pace))

        def report(done: float, doing: str) -> None:
            left_s = pace.find_left_s(done)
            left = _UNKNOWN if left_s is None else str(timedelta(seconds=round(left_s)))
            bar.update(task, completed=done, description=escape_controls(doing), left=left)

        try:
            yield report
        finally:
            _shown.pop()


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
    asked = SystemClock()
    for bar, _ in _shown:
        bar.live.transient = True  # leaves nothing
        bar.stop()
        bar.live.transient = False
    try:
        yield
    finally:
        for bar, pace in _shown:
            pace.leave_out(asked.now_s())
            bar.start()


def _make_console() -> Any:
    from rich.console import Console

    return Console(file=cast("IO[str]", SafeStandardError()))


class _PlainLines:
    """A line at each tenth of the total, at least two seconds apart, with elapsed and remaining time."""

    def __init__(self, title: str, pace: _Pace) -> None:
        self._title, self._pace = title, pace
        self._tenths, self._printed_s = 0, 0.0

    def __call__(self, done: float, doing: str) -> None:
        share, elapsed_s = self._pace.find_share(done), self._pace.now_s()
        if int(10 * share) <= self._tenths or elapsed_s < self._printed_s + _LEAST_PAUSE_S:
            return
        self._tenths, self._printed_s = int(10 * share), elapsed_s
        times = f"{duration(elapsed_s)} elapsed, about {duration(self._pace.find_left_s(done) or 0.0)} left"
        say(f"{self._title}: {100 * share:3.0f} %, {times} ({doing})")
