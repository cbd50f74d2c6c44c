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
from labrig.devices.drives.cia402 import Cia402Drive
from labrig.devices.drives.drive import try_all, wait_for_all
from labrig.devices.exclusive import find_owner
from labrig.errors import BusError, FileFormatError, InputError, SafetyStopError
from labrig.plugins import DRIVES
from labrig.protocol.yaml_file import validate_values
from labrig.protocol.yaml_text import load_tree

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
    can : CanDescription
        Its bus.
    sections : mapping of str to AxisDescription
        For each axis whose node is known, an example of a section with its kind of drive and its node id.
    state_path : Path or None
        State file of the rig, beside which its lock is.
    """

    can: CanDescription
    sections: Mapping[str, AxisDescription]
    state_path: Path | None


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
        can,
        {name: section for name, section in sections.items() if section is not None},
        path.parent / state_file if isinstance(state_file, str) else None,
    )


def _make_section(values: Any) -> AxisDescription | None:
    """Return a section by which a drive can be reached; None if its node is not known."""
    with suppress(InputError, ValidationError, AttributeError, KeyError):
        section = find_section(DRIVES, str(values.get("driver", DEFAULT_DRIVER)), AxisDescription)
        return section.example(values["node_id"])
    return None


def stop_rig(target: StopTarget, clock: Clock | None = None) -> tuple[str, ...]:
    """Ask the labrig that uses a rig to end (SIGTERM), then stop every drive over the bus.

    Returns what was done, one sentence for each step.

    Raises
    ------
    BusError
        When the bus cannot be reached.
    SafetyStopError
        When a drive may still move; names each such drive and what was done.
    """
    clock = clock or SystemClock()
    asked = _end_owner(target.state_path, clock)
    if target.can.interface == ONLY_SIMULATED:
        return (asked, "its drives are simulated inside the labrig that runs them: Ctrl+C there stops them")
    try:
        link = open_can(target.can, clock)
    except BusError as error:
        message = f"{asked}; {error.message}"
        raise error.reword(message, f"press the emergency stop; then: {error.hint}") from error
    with closing(link):
        return (asked, *stop_drives(target, link, clock))


def _end_owner(state_path: Path | None, clock: Clock) -> str:
    """Ask the labrig that uses a rig to end, wait until it lets go, and return what came of it."""
    owner = find_owner(state_path)
    if owner is None:
        return "no labrig has the rig"
    cannot = f"{owner} has the rig and cannot be asked to end from here"
    if owner.host != platform.node() or owner.pid in {0, os.getpid()}:
        return cannot
    try:
        os.kill(owner.pid, signal.SIGTERM)
    except OSError:
        return cannot
    deadline_s = clock.now_s() + LET_GO_WITHIN_S
    while find_owner(state_path) == owner:
        if clock.now_s() > deadline_s:
            return f"asked {owner} to end, and it has not let go of the rig"
        clock.sleep(_LOOK_S)
    return f"asked {owner} to end, and it has let go of the rig"


def stop_drives(target: StopTarget, link: CanLink, clock: Clock) -> tuple[str, ...]:
    """Stop all drives over an open bus; return a sentence for each step.

    Every drive is told to stop before any answer is awaited. Each gets a quick stop and is watched until it stands
    still; then NMT stop goes to all. Raises as `stop_rig`.
    """
    drives = [Cia402Drive(link, section, name, clock) for name, section in target.sections.items()]
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
