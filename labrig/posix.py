"""Signals, worker processes and terminals, as Linux has them."""

import ctypes
import os
import select
import signal
import termios
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TextIO

INTERRUPT_SIGNALS: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request a program to end."""

WORKER_START_METHOD = "fork"
"""Start method of worker processes: a forked one shares the loaded modules and starts in milliseconds."""

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of linux/prctl.h."""

_LONGEST_LINE = 65536


def wait_for_input(stream: TextIO, timeout_s: float) -> bool:
    """Return whether a line can be read; wait at most `timeout_s` for it."""
    return bool(select.select([stream], [], [], timeout_s)[0])


def read_typed(stream: TextIO) -> bytes:
    """Return what was typed and can be read now, at most a line; nothing at the end of input.

    It does not pass through the buffer of the stream, which could keep a second line for the next question.

    Raises `OSError` if the terminal has gone.
    """
    return os.read(stream.fileno(), _LONGEST_LINE)


def discard_typed(stream: TextIO) -> None:
    """Discard what was typed on a terminal and has not been read. Raises `OSError` if the terminal has gone."""
    try:
        termios.tcflush(stream.fileno(), termios.TCIFLUSH)
    except termios.error as error:
        raise OSError(*error.args) from error


def is_in_background(stream: TextIO) -> bool:
    """Return whether a shell runs this process in the background of its terminal: the kernel stops it if it reads."""
    try:
        return os.tcgetpgrp(stream.fileno()) != os.getpgrp()
    except OSError:  # a terminal that controls no process has no background
        return False


@contextmanager
def hold_signals() -> Iterator[None]:
    """Hold signals that request an end until the block has ended; their handlers are called then.

    Python drops what a handler raises inside a hook of a fork. A mask would not keep the signal from the handler: the
    kernel gives it to another thread, such as that of a progress bar, and Python calls the handler in this one.
    """
    if threading.current_thread() is not threading.main_thread():  # handlers are called in no other thread
        yield
        return
    held: list[int] = []
    found = {number: signal.getsignal(number) for number in INTERRUPT_SIGNALS}
    handlers = {number: handler for number, handler in found.items() if handler is not None}
    try:
        for number in handlers:
            signal.signal(number, lambda number, _frame: held.append(number))
        yield
    finally:
        for number, handler in handlers.items():
            signal.signal(number, handler)
        for number in held:
            signal.raise_signal(number)


def end_with_parent() -> None:
    """Make this worker process end on a signal and with its parent; Ctrl+C is left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in INTERRUPT_SIGNALS[1:]:
        signal.signal(number, signal.SIG_DFL)
    # A killed parent ends none of its workers: they would wait for work forever.
    ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGTERM)
