"""Exclusive use of a rig by one labrig at a time: two that beat on one bus would defeat the dead-man of the drives.

The labrig that opens a rig holds a lock beside the rig's state file, and the name of its CAN bus among all accounts of
the computer, whatever rig file and drives each of them has. Both end with the process, however it ends. A simulated rig
without a state file is new in every run; there is nothing to share.
"""

import hashlib
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from labrig.devices.can_description import ONLY_SIMULATED, CanDescription
from labrig.devices.needle_state import load_state
from labrig.devices.rig_file import RigDescription
from labrig.errors import LockedError
from labrig.record.lock import FileLock, LockOwner, read_lock_owner

_NAMED_BY_CHANNEL = frozenset({"socketcan", "slcan"})
"""Interfaces of which each channel is one bus, whatever their options."""


@contextmanager
def acquire_rig(rig: RigDescription, doing: str) -> Iterator[None]:
    """Hold a rig for exclusive use during the block.

    Raises
    ------
    OutputExistsError
        When the file that is to hold the rig's state is a file of something else.
    LockedError
        When another labrig uses it, whose command, process and computer are named, or its bus.
    DiskError
        When the lock cannot be made.
    """
    with ExitStack() as stack:
        try:
            if rig.state_path is not None:
                load_state(rig.state_path)
                stack.enter_context(FileLock(_lock_path(rig.state_path)).acquire(doing))
            if name := name_bus(rig.can):
                stack.enter_context(_claim(name))
        except LockedError as error:
            hint = f"wait until it has ended, or: labrig devices stop {rig.option}"
            raise error.reword(f"rig {rig.name}: {error.message}", hint) from error
        yield


def find_owner(state_path: Path | None) -> LockOwner | None:
    """Return who uses the rig with this state file now; None if nobody does."""
    return None if state_path is None else read_lock_owner(_lock_path(state_path))


def _claim(bus: str) -> socket.socket:
    """Claim a bus among all accounts of this computer until the socket is closed. Raises `LockedError`."""
    end = socket.socket(socket.AF_UNIX)
    try:
        # Without a place in the file system; such a name is at most 107 bytes long.
        end.bind(b"\0" + hashlib.sha256(bus.encode()).hexdigest().encode())
    except OSError as error:
        end.close()
        raise LockedError(f"its bus {bus} is in use by another labrig") from error
    return end


def name_bus(can: CanDescription) -> str:
    """Return the name of a CAN bus on this computer; empty for one inside the process.

    Links to a serial port are followed; options name another bus only where the channel alone does not.
    """
    if can.interface == ONLY_SIMULATED:
        return ""
    options = () if can.interface in _NAMED_BY_CHANNEL else sorted(can.options.items())
    channel = os.path.realpath(can.channel) if can.channel.startswith("/") else can.channel
    return " ".join((can.interface, channel, *(f"{key}={value}" for key, value in options)))


def _lock_path(state_path: Path) -> Path:
    return state_path.with_name(f"{state_path.name}.lock")
