"""Stops a rig from outside, without knowing what it is doing.

It needs nothing but the bus and the node ids of the rig file: whatever else is missing or wrong in the file keeps
nothing from being stopped.
"""

import os
import platform
import signal
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from labrig.clock import Clock
from labrig.devices.axis_description import AXES, DEFAULT_DRIVER, AxisDescription
from labrig.devices.bus import CanLink, open_can
from labrig.devices.can_description import ONLY_SIMULATED, CanDescription
from labrig.devices.clocks import SystemClock
from labrig.devices.driver_section import find_section
from labrig.devices.drives.drive import try_all, wait_for_all
from labrig.devices.exclusive import find_owner
from labrig.errors import BusError, FileFormatError, InputError, SafetyStopError
from labrig.plugins import DRIVES
from labrig.protocol.yaml_file import validate_values
from labrig.protocol.yaml_tree import load_tree
from labrig.record.lock import LockOwner

_STOP_TIME_S = 3.0
_NMT_STOP_ALL = bytes([0x02, 0x00])

LET_GO_WITHIN_S = 5.0
"""How long a labrig that was asked to end may hold the rig [s]. One that supervises stops the axes at once; the drives
of one that hangs have stopped by themselves by then."""

_LOOK_S = 0.05


@dataclass(frozen=True)
class StopTarget:
    """What of a rig file is needed to stop the rig.

    Parameters
    ----------
    name : str
        Name of the rig.
    can : CanDescription
        Its bus.
    sections : mapping of str to AxisDescription
        For each axis whose node is known, an example of a section with its kind of drive and its node id.
    state_path : Path or None
        State file of the rig, beside which its lock is.
    """

    name: str
    can: CanDescription
    sections: Mapping[str, AxisDescription]
    state_path: Path | None


@dataclass(frozen=True)
class StopReport:
    """How a rig was stopped.

    Parameters
    ----------
    by : str
        `bus` if it was stopped over the bus; of a simulated rig, whose drives cannot be reached, `run` if the labrig
        that used it has ended, and `none` if it was asked to or there is none.
    done : tuple of str
        What was done, one sentence for each step.
    """

    by: str
    done: tuple[str, ...]


def read_stop_target(path: Path) -> StopTarget:
    """Read bus, nodes and state file from a rig file, whatever else is wrong with it.

    Raises
    ------
    InputError
        When the file cannot be read, or does not say which bus the drives are on.
    """
    try:
        tree: Any = load_tree(path).values
        values = tree if isinstance(tree, dict) else {}
        can = validate_values(values.get("can"), f"{path}: can", CanDescription)
    except FileFormatError as error:
        hint = f"press the emergency stop: {path} does not say which bus to stop"
        raise error.reword(error.message, hint) from error
    axes, state_file = values.get("axes"), values.get("state_file")
    written = axes if isinstance(axes, dict) else {}
    sections = {name: _make_section(written.get(name)) for name in AXES}
    return StopTarget(
        str(values.get("name", path.stem)),
        can,
        {name: section for name, section in sections.items() if section is not None},
        path.parent / state_file if isinstance(state_file, str) else None,
    )


def _make_section(values: object) -> AxisDescription | None:
    """Return a section by which a drive can be reached; None if its node is not known."""
    if not isinstance(values, dict):
        return None
    node_id = values.get("node_id")
    with suppress(InputError, ValidationError):
        section = find_section(DRIVES, str(values.get("driver", DEFAULT_DRIVER)), AxisDescription)
        return section.example(node_id) if isinstance(node_id, int) else None
    return None


def stop_rig(target: StopTarget, clock: Clock | None = None) -> StopReport:
    """Ask the labrig that uses a rig to end (SIGTERM), then stop every drive over the bus.

    Raises
    ------
    BusError
        When the bus cannot be reached.
    SafetyStopError
        When a drive may still move; names each such drive and what was done.
    """
    clock = clock or SystemClock()
    owner = find_owner(target.can, target.state_path)
    asked, has_ended = ("no labrig has the rig", False) if owner is None else _end(owner, target, clock)
    if target.can.interface == ONLY_SIMULATED:
        if owner is not None:
            return StopReport("run" if has_ended else "none", (asked,))
        where = "its drives are simulated inside the labrig that runs them, Ctrl+C there stops them"
        return StopReport("none", (f"{target.name} has nothing to stop from here: {where}",))
    try:
        link = open_can(target.can, clock)
    except BusError as error:
        message = f"{asked}; {error.message}"
        raise error.reword(message, f"press the emergency stop; then: {error.hint}") from error
    with closing(link):
        return StopReport("bus", (asked, *stop_drives(target, link, clock)))


def _ask_to_end(process: int, host: str) -> bool:
    """Send SIGTERM to a process of a computer; return whether it was sent."""
    if host != platform.node() or process in {0, os.getpid()}:
        return False
    try:
        os.kill(process, signal.SIGTERM)
    except OSError:
        return False
    return True


def _end(owner: LockOwner, target: StopTarget, clock: Clock) -> tuple[str, bool]:
    """Ask the labrig that uses a rig to end; return what came of it, and whether it has let go of the rig."""
    if not _ask_to_end(owner.pid, owner.host):
        return f"{owner} has the rig and cannot be asked to end from here", False
    deadline_s = clock.now_s() + LET_GO_WITHIN_S
    while find_owner(target.can, target.state_path) == owner:
        if clock.now_s() > deadline_s:
            return f"asked {owner} to end, and it has not let go of the rig", False
        clock.sleep(_LOOK_S)
    return f"asked {owner} to end, and it has let go of the rig", True


def stop_drives(target: StopTarget, link: CanLink, clock: Clock) -> tuple[str, ...]:
    """Stop all drives over an open bus; return a sentence for each step.

    Every drive is told to stop before any answer is awaited. Each gets a quick stop and is watched until it stands
    still; then NMT stop goes to all. Raises as `stop_rig`.
    """
    drives = [section.open(link, name, clock) for name, section in target.sections.items()]
    done = [f"opened {target.can.interface} {target.can.channel} directly".replace("  ", " ")]
    missing = [name for name in AXES if name not in target.sections]
    failures = [f"the node of axis {name} is not known" for name in missing]
    failed = try_all(drives, lambda drive: drive.post_stop(quick=True))
    failed += try_all(drives, lambda drive: drive.stop(quick=True))
    failures += [failure.message for failure in failed]
    moving = wait_for_all({drive.name: drive.wait_until_still(_STOP_TIME_S) for drive in drives}, clock)
    done += [f"{drive.name} stands still" for drive in drives if drive.name not in moving]
    failures += moving.values()
    link.send(0x000, _NMT_STOP_ALL)
    done.append("sent NMT stop to all nodes")
    if failures:
        raise SafetyStopError(
            f"not known to stand still: {'; '.join(dict.fromkeys(failures))}; {'; '.join(done)}",
            "press the emergency stop",
        )
    return tuple(done)
