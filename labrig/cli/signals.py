"""INT, TERM and HUP: raised wherever the program is, or noted while a rig is open so that its axes stop first.

A shell starts background jobs with INT ignored, and `nohup` ignores HUP. Both are handled here all the same, because a
needle may be in tissue. While a rig is open, a signal is only noted: the rig checks for it between bus transactions,
stops the axes and raises `InterruptedRunError` itself. While a run is made at a terminal, the first INT is noted as a
request to pause, and stops only at a question, where no safe point can come.
"""

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from labrig.posix import INTERRUPT_SIGNALS

_Handler = Callable[[int, FrameType | None], None]


class Interruption(KeyboardInterrupt):
    """A signal, by name, raised where the program was.

    It is not an `Exception`: libraries catch those around imports and continue, and the signal would be lost.
    """


class SignalNote:
    """Holds the name of the signal that arrived, if any.

    Attributes
    ----------
    asks_for_pause : bool
        Whether INT has asked for a pause that has not begun.
    """

    def __init__(self) -> None:
        self._name: str | None = None
        self._is_pausing = False
        self.asks_for_pause = False

    def __call__(self) -> str | None:
        """Return the name of the signal that stops, or None."""
        return self._name

    def insist(self) -> str | None:
        """Return the name of the signal, also of one that asked for a pause; that one stops from now on."""
        if self.asks_for_pause:
            self._name = self._name or signal.SIGINT.name
        return self._name

    def take(self, number: int, _frame: FrameType | None) -> None:
        """Note a signal, as a signal handler."""
        # Only the first INT asks for a pause.
        if self._is_pausing and number == signal.SIGINT and not (self._name or self.asks_for_pause):
            self.asks_for_pause = True
        else:
            self._name = signal.Signals(number).name

    @contextmanager
    def pausing(self, *, enabled: bool) -> Iterator[None]:
        """Let INT ask for a pause during the block, or let it stop; outside of any block it stops."""
        before, self._is_pausing = self._is_pausing, enabled
        try:
            yield
        finally:
            self._is_pausing = before


def raise_until_exit() -> None:
    """Raise `Interruption` at every signal until the program ends."""
    for number in INTERRUPT_SIGNALS:
        signal.signal(number, _raise)


def ignore_until_exit() -> None:
    """Ignore signals: the work is done and the exit code is decided."""
    for number in INTERRUPT_SIGNALS:
        signal.signal(number, signal.SIG_IGN)


@contextmanager
def raise_on_signals() -> Iterator[None]:
    """Raise `Interruption` wherever the program is when a signal arrives."""
    with _install_handler(_raise):
        yield


@contextmanager
def note_signals() -> Iterator[SignalNote]:
    """Note signals instead of raising while a rig is open; ask the note again after the block."""
    note = SignalNote()
    with _install_handler(note.take):
        yield note


def _raise(number: int, _frame: FrameType | None) -> None:
    raise Interruption(signal.Signals(number).name)


@contextmanager
def _install_handler(handler: _Handler) -> Iterator[None]:
    before = {number: signal.signal(number, handler) for number in INTERRUPT_SIGNALS}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)
