"""What only POSIX systems can do; nothing else of labrig imports their modules for it.

On Windows there are no pseudo-terminals, and the simulated serial adapter cannot be made there.
"""

import os
import select
import sys
from dataclasses import dataclass

from labrig.errors import MachineError

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
