"""What only POSIX systems can do; nothing else of labrig imports their modules for it.

On Windows there are no pseudo-terminals, and the simulated serial adapter cannot be made there; nor are there Unix
sockets in Python, so that another labrig cannot be asked to stop.
"""

import os
import select
import socket
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

from labrig.errors import DiskError, MachineError

if sys.platform != "win32":
    import pty
    import tty

_MOST_AT_ONCE = 65536


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
        """Return the next line, waiting at most `timeout_s`; None when none came."""
        while b"\n" not in self._heard:
            readable, _, _ = select.select([self._end], [], [], timeout_s)
            more = self._end.recv(_MOST_AT_ONCE) if readable else b""
            if not more:
                return None
            self._heard += more
        line, _, self._heard = self._heard.partition(b"\n")
        return line.decode("utf-8", "replace")

    def close(self) -> None:
        """Hang up."""
        self._end.close()


class Listener:
    """A Unix socket in the file system that only its owner may reach (mode 0600).

    Parameters
    ----------
    path : Path
        Where; what stands there is replaced, so whoever listens must hold a lock.

    Raises
    ------
    DiskError
        When it cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        mask = os.umask(0o177)
        try:
            path.unlink(missing_ok=True)
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


def call(path: Path) -> Conversation | None:
    """Connect to a listener; None where nobody listens."""
    if sys.platform == "win32":
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
