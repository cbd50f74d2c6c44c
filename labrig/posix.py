"""What POSIX systems have and others have not, or have otherwise; the one file of labrig with such calls.

On Windows, where labrig was never tried: the simulated serial adapter cannot be made, because there are no
pseudo-terminals; a running labrig cannot be asked to stop, because Python has no Unix sockets there; a person cannot be
asked while drives are watched; camera controls cannot be set; and the names of new files are not made durable. Each
says so, or is left out where nothing is lost by it.
"""

import ctypes
import os
import select
import signal
import socket
import stat
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TextIO

from labrig.errors import DiskError, MachineError

if sys.platform == "win32":
    import msvcrt
else:
    import fcntl
    import pty
    import tty

INTERRUPTING = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)
)
"""Signals that ask a program to end."""

NO_LINKS = getattr(os, "O_NOFOLLOW", 0)
"""Flag for os.open: a symbolic link is not followed."""

WORKERS_ARE = "spawn" if sys.platform == "win32" else "fork"
"""How worker processes are started: forked, they share what is loaded and start in milliseconds."""

_DIE_WITH_PARENT = 1
"""PR_SET_PDEATHSIG of linux/prctl.h."""

_LOCKED_BYTE = 2**20
"""Beyond any text: Windows locks bytes, and a locked one cannot be read."""

_MOST_AT_ONCE = 65536

_LONGEST_LINE = 65536
_MOST_READS = 16
"""Of a conversation, for a line: whoever sends byte by byte, or without end, holds nobody up."""


@dataclass(frozen=True)
class PseudoTerminal:
    """Both ends of a pseudo-terminal; programs open `path` as if it were a serial port."""

    path: str
    own_end: int
    other_end: int

    def read(self, timeout_s: float) -> bytes:
        """Return what has been written at the other end, waiting at most `timeout_s`."""
        readable, _, _ = select.select([self.own_end], [], [], max(0.0, timeout_s))
        return os.read(self.own_end, _MOST_AT_ONCE) if readable else b""

    def write(self, data: bytes) -> None:
        """Let the other end read `data`; what nobody reads is dropped once the terminal is full."""
        try:
            os.write(self.own_end, data)
        except BlockingIOError:
            return

    def close(self) -> None:
        """Take the terminal away, as pulling a USB plug does."""
        for end in (self.other_end, self.own_end):
            os.close(end)


def open_pseudo_terminal() -> PseudoTerminal:
    """Return a new pseudo-terminal that passes bytes on as they are.

    Raises
    ------
    MachineError
        Where there are none.
    """
    if sys.platform == "win32":
        raise MachineError("Windows has no pseudo-terminals", "use udp_multicast instead of slcan")
    own_end, other_end = pty.openpty()
    tty.setraw(other_end)
    os.set_blocking(own_end, False)
    # Our copy of the other end stays open, so that clients may come and go.
    return PseudoTerminal(os.ttyname(other_end), own_end, other_end)


class Conversation:
    """One end of a connected Unix socket on which lines are exchanged.

    Parameters
    ----------
    end : socket.socket
        The end; closing the conversation closes it.
    """

    def __init__(self, end: socket.socket) -> None:
        self._end = end
        self._heard = b""

    def say(self, line: str) -> bool:
        """Send a line; return whether anybody took it."""
        try:
            self._end.sendall(line.encode() + b"\n")
        except OSError:
            return False
        return True

    def hear(self, timeout_s: float) -> str | None:
        """Return the next line, waiting at most `timeout_s` for each part of it; None when none came.

        A line that is too long is returned as far as it has been read.
        """
        for _ in range(_MOST_READS):
            if b"\n" in self._heard or len(self._heard) > _LONGEST_LINE:
                line, _, self._heard = self._heard.partition(b"\n")
                return line.decode("utf-8", "replace")
            readable, _, _ = select.select([self._end], [], [], timeout_s)
            more = self._end.recv(_MOST_AT_ONCE) if readable else b""
            if not more:
                return None
            self._heard += more
        return None

    def close(self) -> None:
        """Hang up."""
        self._end.close()


class Listener:
    """A Unix socket in the file system that only its owner may reach (mode 0600).

    Parameters
    ----------
    path : Path
        Where; a socket that stands there is replaced, so whoever listens must hold a lock.

    Raises
    ------
    DiskError
        When it cannot be made, or a file that is no socket stands there.
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
        self._socket.setblocking(False)  # noqa: FBT003 - the standard library has it so

    def accept(self) -> Conversation | None:
        """Return whoever has called, without waiting; None when nobody has."""
        try:
            end, _ = self._socket.accept()
        except OSError:
            return None
        end.settimeout(1.0)
        return Conversation(end)

    def close(self) -> None:
        """Take the socket away."""
        self._socket.close()
        with suppress(OSError):
            self.path.unlink()


def listen(path: Path) -> Listener | None:
    """Return a listener; None on Windows, which has none. Raises `DiskError`."""
    return Listener(path) if hasattr(socket, "AF_UNIX") else None


def call(path: Path) -> Conversation | None:
    """Connect to a listener; None where nobody listens."""
    if not hasattr(socket, "AF_UNIX"):
        return None
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    end.settimeout(1.0)
    try:
        with _Address(path) as address:
            end.connect(address)
    except OSError:
        end.close()
        return None
    return Conversation(end)


class _Address:
    """The address of a socket: its path, or, as such may have 107 bytes only, a short one by way of its folder."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._folder: int | None = None

    def __enter__(self) -> str:
        if len(os.fsencode(self._path)) < 100 or not sys.platform.startswith("linux"):
            return str(self._path)
        self._folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
        return f"/proc/self/fd/{self._folder}/{self._path.name}"

    def __exit__(self, *_: object) -> None:
        if self._folder is not None:
            os.close(self._folder)


def wait_for_input(stream: TextIO, timeout_s: float) -> bool:
    """Return whether a line can be read, waiting at most `timeout_s`.

    Raises
    ------
    MachineError
        On Windows, where only sockets can be waited for.
    """
    if sys.platform == "win32":
        raise MachineError(
            "on Windows nobody can be asked while drives are watched", "run the bench from Linux or macOS"
        )
    return bool(select.select([stream], [], [], timeout_s)[0])


def lock_at_once(descriptor: int) -> None:
    """Lock an open file for this process without waiting. Raises `OSError` where another holds it."""
    if sys.platform == "win32":
        os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
        os.lseek(descriptor, 0, os.SEEK_SET)
    else:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


def sync_directory(path: Path) -> None:
    """Make the names in a folder durable."""
    if sys.platform == "win32":
        return
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def reserve(descriptor: int, size_bytes: int) -> None:
    """Let the file system set bytes aside for a file. Raises `OSError` where it has none left."""
    if sys.platform in {"win32", "darwin"}:
        os.write(descriptor, bytes(size_bytes))
    else:
        os.posix_fallocate(descriptor, 0, size_bytes)


def control_device(descriptor: int, request: int, argument: bytes) -> bytes:
    """Send a request to a device (ioctl) and return its answer. Raises `OSError` where it refuses it."""
    if sys.platform == "win32":
        raise OSError("Windows has no ioctl")
    return fcntl.ioctl(descriptor, request, argument)


def end_with_parent() -> None:
    """Let a signal end this worker process, and the end of its parent too; Ctrl+C is left to the parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in INTERRUPTING[1:]:
        signal.signal(number, signal.SIG_DFL)
    # A parent that is killed ends nobody; its workers would wait for work for ever.
    if sys.platform.startswith("linux"):
        ctypes.CDLL(None).prctl(_DIE_WITH_PARENT, signal.SIGTERM)


def usable_cores() -> int:
    """Return how many cores this process may use: `taskset`, a container or a batch system may leave it fewer."""
    if sys.platform.startswith("linux"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def make_private_folder(path: Path) -> None:
    """Make a folder that only this account can enter; one that exists must be such a folder.

    Raises
    ------
    DiskError
        When it cannot be made, is a link or a file, belongs to another account, or is open to others.
    """
    try:
        path.mkdir(mode=0o700, exist_ok=True)
        found = path.lstat()
    except OSError as error:
        raise DiskError(f"cannot make {path}: {error.strerror}", "check its permissions") from error
    if sys.platform == "win32":
        return
    if not stat.S_ISDIR(found.st_mode):
        raise DiskError(f"{path} is a link, not a folder", "remove it")
    if found.st_uid != os.getuid():
        raise DiskError(
            f"{path} belongs to account {found.st_uid}, not to {os.getuid()}", "have its owner remove it"
        )
    if found.st_mode & 0o077:
        raise DiskError(
            f"other accounts can use {path}: its mode is {stat.S_IMODE(found.st_mode):03o}, not 700",
            f"chmod 700 {path}",
        )


def user() -> str:
    """Return who runs this process, fit for a file name."""
    return os.environ.get("USERNAME", "user") if sys.platform == "win32" else str(os.getuid())
