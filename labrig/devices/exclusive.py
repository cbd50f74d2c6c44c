"""Exclusive use of a rig by one labrig at a time: two that beat on one bus would defeat the dead-man of the drives.

The labrig that opens a rig holds a lock beside the rig's state file, and the name of its CAN bus among all accounts of
the computer, whatever rig file and drives each of them has. Both end with the process, however it ends. A simulated rig
without a state file is new in every run; there is nothing to share.
"""

import hashlib
import os
import platform
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from labrig.devices.can_description import ONLY_SIMULATED, CanDescription
from labrig.devices.needle_state import require_own_state
from labrig.devices.rig_file import RigDescription
from labrig.errors import LockedError
from labrig.record.lock import FileLock, LockOwner, read_lock_owner

_NAMED_BY_CHANNEL = frozenset({"socketcan", "slcan"})
"""Interfaces of which each channel is one bus, whatever their options."""


_CREDENTIALS = struct.Struct("3i")
"""Process, account and group of a peer, as SO_PEERCRED gives them."""


@contextmanager
def acquire_rig(rig: RigDescription, doing: str) -> Iterator[None]:
    """Hold a rig for exclusive use during the block.

    Raises
    ------
    OutputExistsError
        When the file that is to hold the rig's state is a file of something else.
    LockedError
        When another labrig uses it or its bus; names what it does, its process and its computer.
    DiskError
        When the lock cannot be made.
    """
    with ExitStack() as stack:
        if rig.state_path is not None:
            require_own_state(rig.state_path)
            try:
                stack.enter_context(FileLock(_lock_path(rig.state_path)).acquire(doing))
            except LockedError as error:
                raise _in_use(rig, read_lock_owner(_lock_path(rig.state_path))) from error
        bus = name_bus(rig.can)
        if bus:
            claim = _claim_name(bus)
            if claim is None:
                raise _in_use(rig, _find_claimant(rig.can))
            stack.callback(claim.close)
        yield


def _in_use(rig: RigDescription, owner: LockOwner | None) -> LockedError:
    where = f"{rig.can.interface} {rig.can.channel}".strip()
    return LockedError(
        f"rig {rig.name}, or its CAN bus {where}, is in use by {owner or 'another labrig'}",
        f"wait until it has ended, or: labrig devices stop {rig.option}",
    )


def find_owner(can: CanDescription, state_path: Path | None) -> LockOwner | None:
    """Return who uses a rig, or its bus, now; None if nobody does."""
    owner = None if state_path is None else read_lock_owner(_lock_path(state_path))
    return owner or _find_claimant(can)


def _find_claimant(can: CanDescription) -> LockOwner | None:
    bus = name_bus(can)
    process = _find_peer(bus) if bus else None
    return None if process is None else LockOwner("another labrig on its bus", process, platform.node())


def _claim_name(name: str) -> socket.socket | None:
    """Claim a name among all accounts of this computer until the socket is closed; None if another process has it."""
    end = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    try:
        end.bind(_abstract_address(name))
        end.listen()
    except OSError:
        end.close()
        return None
    return end


def _find_peer(name: str) -> int | None:
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


def _abstract_address(name: str) -> bytes:
    """Return the address of a socket without a place in the file system, which is at most 107 bytes long."""
    return b"\0" + hashlib.sha256(name.encode()).hexdigest().encode()


def name_bus(can: CanDescription) -> str:
    """Return the name of a CAN bus on this computer; empty for one inside the process.

    Links to a serial port are followed; options name another bus only where the channel alone does not.
    """
    if can.interface == ONLY_SIMULATED:
        return ""
    options = () if can.interface in _NAMED_BY_CHANNEL else sorted(can.options.items())
    channel = os.path.realpath(can.channel) if can.channel.startswith("/") else can.channel
    words = ("".join(filter(str.isalnum, word)) for word in (can.interface, channel, *map(str, options)))
    return "-".join(filter(None, ("labrig-can", *words)))


def _lock_path(state_path: Path) -> Path:
    return state_path.with_name(f"{state_path.name}.lock")
