"""Calls of the operating system, which is Linux; no other file of labrig makes them."""

import ctypes
import fcntl
import hashlib
import os
import platform
import select
import signal
import socket
import struct
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

INTERRUPT_SIGNALS: tuple[int, ...] = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that request a program to end."""

NO_LINKS = os.O_NOFOLLOW
"""Flag for os.open: a symbolic link is not followed."""

WORKER_START_METHOD = "fork"
"""Start method of worker processes: a forked one shares the loaded modules and starts in milliseconds."""

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of linux/prctl.h."""

_LESS_URGENT = 10
"""By how much a process is nicer than one that moves axes."""

_LONGEST_LINE = 65536


_CREDENTIALS = struct.Struct("3i")
"""Process, account and group of a peer, as SO_PEERCRED gives them."""


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


def claim_name(name: str) -> socket.socket | None:
    """Claim a name among all accounts of this computer until the socket is closed; None if another process has it."""
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        end.bind(_abstract_address(name))
        end.listen()
    except OSError:
        end.close()
        return None
    return end


def find_claimant(name: str) -> int | None:
    """Return which process has a name, 0 if that cannot be told; None if none has it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as caller:
        caller.settimeout(0.0)
        try:
            caller.connect(_abstract_address(name))
        except BlockingIOError:  # so many have looked that no more are let in
            return 0
        except OSError:
            return None
        credentials = caller.getsockopt(socket.SOL_SOCKET, socket.SO_PEERCRED, _CREDENTIALS.size)
    process, _, _ = _CREDENTIALS.unpack(credentials)
    return int(process)


def ask_to_end(process: int, host: str) -> bool:
    """Send SIGTERM to a process of a computer; return whether it was sent."""
    if host != platform.node() or process in {0, os.getpid()}:
        return False
    try:
        os.kill(process, signal.SIGTERM)
    except OSError:
        return False
    return True


def _abstract_address(name: str) -> bytes:
    """Return the address of a socket without a place in the file system, which is at most 107 bytes long."""
    return b"\0" + hashlib.sha256(name.encode()).hexdigest().encode()


def sync_directory(path: Path) -> None:
    """Make the names in a folder durable."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserve(descriptor: int, size_bytes: int) -> None:
    """Allocate disk space for a file. Raises `OSError` if the disk has no space left."""
    os.posix_fallocate(descriptor, 0, size_bytes)


def control_device(descriptor: int, request: int, argument: bytes) -> bytes:
    """Send a request to a device (ioctl) and return its answer. Raises `OSError` if the device refuses it."""
    return fcntl.ioctl(descriptor, request, argument)


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


def lower_priority() -> None:
    """Let other processes go before this one wherever both want the processor."""
    os.nice(_LESS_URGENT)


def count_usable_cores() -> int:
    """Return how many cores this process may use: `taskset`, a container or a batch system may allow fewer than all."""
    return len(os.sched_getaffinity(0))


def open_serial_line() -> tuple[int, int, str]:
    """Return both ends of a serial line, the first of which never waits, and the name of the second."""
    end, other = os.openpty()
    tty.setraw(other)
    os.set_blocking(end, False)
    return end, other, os.ttyname(other)
