"""INT, TERM and HUP: raised as one error, or noted while a rig is open so that its axes are stopped first.

A shell starts background jobs with INT ignored, and `nohup` ignores HUP; both are taken here all the same, because a
needle may be in tissue. While a rig is open the signal is only noted: the rig asks for it between two bus
transactions, stops the axes and raises `InterruptedRunError` itself.
"""

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

from labrig.errors import InterruptedRunError

_SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class SignalNote:
    """Holds the name of the signal that arrived, once one did."""

    def __init__(self) -> None:
        self._name: str | None = None

    def __call__(self) -> str | None:
        """Return the name of the signal, or None."""
        return self._name

    def take(self, number: int, _frame: FrameType | None) -> None:
        """Note a signal; the form of a signal handler."""
        self._name = signal.Signals(number).name


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise `InterruptedRunError` wherever the program stands when a signal arrives."""

    def interrupt(number: int, _frame: FrameType | None) -> None:
        raise InterruptedRunError(f"interrupted by {signal.Signals(number).name}")

    with _handlers(interrupt):
        yield


@contextmanager
def note_signals() -> Iterator[SignalNote]:
    """Note signals instead of raising, for as long as a rig is open."""
    note = SignalNote()
    with _handlers(note.take):
        yield note


@contextmanager
def _handlers(handler: object) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in _SIGNALS}  # type: ignore[arg-type]
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
