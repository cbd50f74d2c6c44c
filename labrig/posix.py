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
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TextIO

from labrig.errors import DiskError

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

_CHUNK_BYTES = 65536

_LONGEST_LINE = 65536
_MOST_READS = 16
"""Limits for a line: a sender of single bytes, or of an endless line, delays nobody."""


_CREDENTIALS = struct.Struct("3i")
"""Process, account and group of a peer, as SO_PEERCRED gives them."""


class LineSocket:
    """A connected Unix socket that carries lines of text.

    Parameters
    ----------
    connection : socket.socket
        The socket; `close` closes it.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._received = b""

    def send(self, line: str) -> bool:
        """Send a line; return whether the other end still accepts it."""
        try:
            self._connection.sendall(line.encode() + b"\n")
        except OSError:
            return False
        return True

    def receive(self, timeout_s: float) -> str | None:
        """Return the next line, or None if none arrives; wait at most `timeout_s` for each part of it.

        A line that is too long is returned as far as it has been read.
        """
        for _ in range(_MOST_READS):
            if b"\n" in self._received or len(self._received) > _LONGEST_LINE:
                line, _, self._received = self._received.partition(b"\n")
                return line.decode("utf-8", "replace")
            readable, _, _ = select.select([self._connection], [], [], timeout_s)
            more = self._connection.recv(_CHUNK_BYTES) if readable else b""
            if not more:
                return None
            self._received += more
        return None

    def close(self) -> None:
        """Close the connection."""
        self._connection.close()


class Listener:
    """A Unix socket in the file system to which only its owner may connect (mode 0600).

    Parameters
    ----------
    path : Path
        Path of the socket; an existing socket is replaced, so the caller must hold a lock.

    Raises
    ------
    DiskError
        When the socket cannot be made, or the path is a file of another kind.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        mask = os.umask(0o177)
        try:
            if path.is_socket():
                path.unlink()
            with _Address(path) as address:
                self._socket.bind(address)
            self._socket.listen(4)
        except OSError as error:
            self._socket.close()
            raise DiskError(
                f"cannot listen at {path}: {error.strerror or error}", "check the folder of the rig file"
            ) from error
        finally:
            os.umask(mask)
        self._socket.setblocking(False)  # noqa: FBT003 - the signature of the standard library

    def accept(self) -> LineSocket | None:
        """Return the next connection, or None without waiting if there is none."""
        try:
            connection, _ = self._socket.accept()
        except OSError:
            return None
        connection.settimeout(1.0)
        return LineSocket(connection)

    def close(self) -> None:
        """Close and delete the socket."""
        self._socket.close()
        with suppress(OSError):
            self.path.unlink()


def connect(path: Path) -> LineSocket | None:
    """Connect to a listener; return None if nobody listens."""
    connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connection.settimeout(1.0)
    try:
        with _Address(path) as address:
            connection.connect(address)
    except OSError:
        connection.close()
        return None
    return LineSocket(connection)


class _Address:
    """The address of a socket: its path, or a short path through its folder, since an address has at most 107 bytes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder: int | None = None

    def __enter__(self) -> str:
        if len(os.fsencode(self._path)) < 100:
            return str(self._path)
        self._folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
        return f"/proc/self/fd/{self._folder}/{self._path.name}"

    def __exit__(self, *_: object) -> None:
        if self._folder is not None:
            os.close(self._folder)


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
