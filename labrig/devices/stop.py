"""Stops a rig from outside, without knowing what it is doing."""

from contextlib import closing
from dataclasses import dataclass

from labrig.clock import Clock
from labrig.devices.bus import CanLink, open_can
from labrig.devices.can_description import ONLY_SIMULATED
from labrig.devices.clocks import SystemClock
from labrig.devices.control import Reply, ask_to_stop, find_owner
from labrig.devices.drive import open_drive, wait_for_all
from labrig.devices.rig_file import RigDescription
from labrig.errors import BusError, MachineError, SafetyStopError

_STOP_TIME_S = 3.0
_NMT_STOP_ALL = bytes([0x02, 0x00])


@dataclass(frozen=True)
class StopReport:
    """How a rig was stopped.

    Parameters
    ----------
    by : str
        `run` if the labrig that uses the rig stopped it, `bus` if this one did over the bus, `none` if a
        simulated rig has no drives that can be reached.
    done : tuple of str
        What was done, one sentence for each step.
    """

    by: str
    done: tuple[str, ...]


def stop_rig(rig: RigDescription) -> StopReport:
    """Ask the labrig that uses the rig to stop it; if it does not answer, stop every drive over the bus.

    Over the bus, every drive gets a quick stop and is watched until it stands still; then NMT stop goes to all. This
    needs only bus and node ids, so an incomplete rig file suffices. Every drive is told to stop before any is waited
    for.

    Raises
    ------
    BusError
        When the bus cannot be reached.
    SafetyStopError
        When a drive may still move; names each such drive and what was done.
    """
    reply = ask_to_stop(rig)
    if reply is not None and reply.failures == ():
        return StopReport("run", (f"asked {reply.owner} to stop", "it has seen every axis stand still"))
    before = _explain_no_stop(rig, reply)
    if rig.can.interface == ONLY_SIMULATED:
        before = before if rig.state_path is not None else ()
        where = "its drives are simulated inside the labrig that runs them, Ctrl+C there stops them"
        return StopReport("none", (*before, f"{rig.name} has nothing to stop from here: {where}"))
    clock = SystemClock()
    try:
        link = open_can(rig.can, clock)
    except BusError as error:
        message = f"{'; '.join(before)}; {error.message}"
        raise error.reword(message, f"press the emergency stop; then: {error.hint}") from error
    with closing(link):
        return StopReport("bus", (*before, *stop_drives(rig, link, clock)))


def _explain_no_stop(rig: RigDescription, reply: Reply | None) -> tuple[str, ...]:
    """Return why the labrig that uses the rig did not stop it."""
    if reply is None:
        owner = find_owner(rig)
        return (f"{owner} has the rig and does not listen",) if owner else ("no labrig has the rig",)
    if reply.failures is None:
        return (f"{reply.owner or 'the labrig that has the rig'} did not answer",)
    return (f"{reply.owner} could not stop it: {'; '.join(reply.failures)}",)


def stop_drives(rig: RigDescription, link: CanLink, clock: Clock) -> tuple[str, ...]:
    """Stop all drives over an open bus, as `stop_rig` does; return a sentence for each step."""
    drives = [open_drive(link, axis, name, clock) for name, axis in rig.axes.items()]
    done = [f"opened {rig.can.interface} {rig.can.channel} directly".replace("  ", " ")]
    failures = []
    for drive in drives:
        drive.post_stop(quick=True)
    for drive in drives:
        try:
            drive.stop(quick=True)
        except MachineError as error:
            failures.append(error.message)
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
