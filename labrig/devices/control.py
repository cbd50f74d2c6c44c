"""Exclusive use of a rig by one labrig at a time, and requests of another one to stop it.

The labrig that opens a rig holds a lock beside the rig's state file, one for its CAN bus in a folder of this user, and
the name of the bus among all users of the computer: two labrigs that beat on one bus defeat the dead-man, whatever rig
file, drives or account each of them has. It listens on a Unix socket beside the
state file and polls it between two bus transactions, without a thread, so that a labrig that hangs does not answer.
A simulated rig without a state file is new in every run; there is nothing to share.
"""

import json
import os
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.needle_state import require_own_state
from labrig.devices.rig_file import RigDescription
from labrig.errors import LockedError
from labrig.input_file import parse_json
from labrig.posix import (
    LineSocket,
    NameClaim,
    claim_name,
    connect,
    find_claimant,
    identify_user,
    listen,
    make_private_folder,
)
from labrig.record.lock import FileLock, read_lock_owner

_SOCKET, _STOP = ".socket", "stop"
_CLAIM = "labrig-can-"
_NAMED_BY_CHANNEL = frozenset({"socketcan", "slcan"})
"""Interfaces of which each channel is one bus, whatever their options."""

_MOST_SILENT = 8
"""Most callers that have connected but sent nothing; beyond that the oldest are dropped."""

_TAKEN_WITHIN_S = 1.0
_DONE_WITHIN_S = 10.0
"""An axis gets max_speed / acceleration + 0.5 s twice; this is longer than any sensible rig needs."""


class StopRequests:
    """Receives requests to stop the rig, and answers when every axis stands still.

    Parameters
    ----------
    path : Path
        Socket to listen on; the caller holds the rig's lock.
    doing : str
        What the rig is used for, as told to a caller.

    Raises
    ------
    DiskError
        When the socket cannot be made.
    """

    def __init__(self, path: Path, doing: str) -> None:
        self._listener = listen(path)
        self._doing = doing
        self._silent: list[LineSocket] = []
        self._callers: list[LineSocket] = []
        self._arrived = False

    def poll(self) -> bool:
        """Check for a request without waiting; return whether one has arrived, now or before."""
        self._accept_callers()
        for caller in tuple(self._silent):
            line = caller.receive(0.0)
            if line is None:
                continue
            self._silent.remove(caller)
            if line == _STOP:
                caller.send(json.dumps({"taken_by": self._doing, "pid": os.getpid()}))
                self._callers.append(caller)
                self._arrived = True
            else:
                caller.close()
        return self._arrived

    def _accept_callers(self) -> None:
        """Accept some callers; if that makes too many that have sent nothing, hang up on the oldest."""
        for _ in range(_MOST_SILENT):
            caller = None if self._listener is None else self._listener.accept()
            if caller is None:
                return
            self._silent.append(caller)
            if len(self._silent) > _MOST_SILENT:
                self._silent.pop(0).close()

    def answer(self, failures: Sequence[str]) -> None:
        """Tell the callers that every axis stands still, or which may still move."""
        for caller in self._callers:
            caller.send(json.dumps({"failures": list(failures)}))
            caller.close()
        self._callers.clear()

    def close(self) -> None:
        """Stop listening."""
        self.answer(["labrig ended before every axis was seen to stand still"])
        for caller in self._silent:
            caller.close()
        if self._listener is not None:
            self._listener.close()


@contextmanager
def acquire_rig(rig: RigDescription, doing: str) -> Iterator[StopRequests | None]:
    """Hold a rig for exclusive use during the block; yields None if no other process could reach it.

    Raises
    ------
    OutputExistsError
        When the file that is to hold the rig's state is a file of something else.
    LockedError
        When another labrig uses it or its drives; names what it does, its process and its computer.
    DiskError
        When lock or socket cannot be made, or other accounts can use the folder of the locks.
    """
    if rig.state_path is not None:
        require_own_state(rig.state_path)
    if rig.can.interface != ONLY_SIMULATED:
        make_private_folder(_find_lock_folder())
    with ExitStack() as stack:
        for path in find_lock_paths(rig):
            stack.enter_context(_hold_lock(rig, path, doing))
        stack.callback(_claim_bus(rig).release)
        if rig.state_path is None:
            yield None
            return
        requests = StopRequests(_append_ending(rig.state_path, _SOCKET), doing)
        stack.callback(requests.close)
        yield requests


def find_lock_paths(rig: RigDescription) -> tuple[Path, ...]:
    """Return the lock of the rig's state and that of its bus; none for a rig new in every run."""
    own = () if rig.state_path is None else (_append_ending(rig.state_path, ".lock"),)
    bus = _name_bus(rig)
    return (*own, _find_lock_folder() / f"{bus}.lock") if bus else own


def _name_bus(rig: RigDescription) -> str:
    """Return the name of the CAN bus on this computer; empty for one inside the process.

    Links to a serial port are followed; options name another bus only where the channel alone does not.
    """
    if rig.can.interface == ONLY_SIMULATED:
        return ""
    options = () if rig.can.interface in _NAMED_BY_CHANNEL else sorted(rig.can.options.items())
    channel = os.path.realpath(rig.can.channel) if rig.can.channel.startswith("/") else rig.can.channel
    words = ("".join(filter(str.isalnum, word)) for word in (rig.can.interface, channel, *map(str, options)))
    return "-".join(filter(None, words))


def _claim_bus(rig: RigDescription) -> NameClaim:
    """Claim the bus of a rig among all users of this computer. Raises `LockedError`."""
    name = _name_bus(rig)
    claim = claim_name(_CLAIM + name) if name else NameClaim(None)
    if claim is None:
        where = f"{rig.can.interface} {rig.can.channel}".strip()
        raise LockedError(
            f"the CAN bus {where} of rig {rig.name} is in use by another labrig ({find_claimant(_CLAIM + name)})",
            "wait until it has ended: two programs that command drives on one bus defeat their dead-man",
        )
    return claim


def find_owner(rig: RigDescription) -> str:
    """Return who uses a rig or its bus now; empty if nobody does."""
    owners = (read_lock_owner(path) for path in find_lock_paths(rig))
    found = next((str(owner) for owner in owners if owner is not None), "")
    name = _name_bus(rig)
    claimant = find_claimant(_CLAIM + name) if name and not found else ""
    return found or (f"another labrig on its bus ({claimant})" if claimant else "")


@contextmanager
def _hold_lock(rig: RigDescription, path: Path, doing: str) -> Iterator[None]:
    lock = FileLock(path)
    try:
        lock.acquire(doing)
    except LockedError as error:
        raise LockedError(
            f"rig {rig.name} is in use by {read_lock_owner(path) or 'another labrig'}",
            f"wait until it has ended, or: labrig devices stop {rig.option}",
        ) from error
    with lock:
        yield


def _find_lock_folder() -> Path:
    """Return the folder of this account for the locks of drives, which need not exist yet."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    return (
        Path(runtime) / "labrig"
        if runtime and Path(runtime).is_dir()
        else Path(tempfile.gettempdir()) / f"labrig-{identify_user()}"
    )


def _append_ending(path: Path, ending: str) -> Path:
    return path.with_name(path.name + ending)


@dataclass(frozen=True)
class Reply:
    """The reply of the labrig that uses a rig to a request to stop.

    Parameters
    ----------
    owner : str
        What it does, and its process.
    failures : tuple of str or None
        Axes that may still move, and why; None if it did not reply in time.
    """

    owner: str
    failures: tuple[str, ...] | None


def ask_to_stop(rig: RigDescription) -> Reply | None:
    """Ask the labrig that uses a rig to stop every axis, and wait for its readback.

    Returns
    -------
    Reply or None
        None if nobody listens. One that hangs gets a second, one that is stopping gets ten.
    """
    caller = None if rig.state_path is None else connect(_append_ending(rig.state_path, _SOCKET))
    if caller is None:
        return None
    try:
        caller.send(_STOP)
        taken = _parse_reply(caller.receive(_TAKEN_WITHIN_S))
        done = _parse_reply(caller.receive(_DONE_WITHIN_S) if taken else None)
    finally:
        caller.close()
    owner = f"{taken['taken_by']} (process {taken['pid']})" if taken else find_owner(rig)
    return Reply(owner, tuple(map(str, done["failures"])) if done else None)


def _parse_reply(line: str | None) -> dict[str, Any]:
    try:
        document = parse_json((line or "{}").encode())
    except ValueError:
        return {}
    return document if isinstance(document, dict) else {}
