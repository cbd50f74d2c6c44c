"""Stopping a rig from outside, when nothing is known of what it is doing."""

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
        `run` where the labrig that has the rig stopped it, `bus` where this one did over the bus, `none` where a
        simulated rig has no drives that could be reached.
    done : tuple of str
        What was done, a sentence each.
    """

    by: str
    done: tuple[str, ...]


def stop_rig(rig: RigDescription) -> StopReport:
    """Let the labrig that has the rig stop it; where it does not answer, stop every drive over the bus.

    Over the bus every drive is quick-stopped, seen to stand still, and NMT stop is sent to all. Nothing of the rig
    file is needed for it but bus and node ids, so that an incomplete one will do. Every drive is told to stop
    before any is waited for.

    Raises
    ------
    BusError
        When the bus cannot be reached.
    SafetyStopError
        When a drive is not known to stand still; names each and what was done.
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
    """Say why the labrig that has the rig did not stop it; nothing where nobody has it."""
    if reply is None:
        owner = find_owner(rig)
        return (f"{owner} has the rig and does not listen",) if owner else ("no labrig has the rig",)
    if reply.failures is None:
        return (f"{reply.owner or 'the labrig that has the rig'} did not answer",)
    return (f"{reply.owner} could not stop it: {'; '.join(reply.failures)}",)


def stop_drives(rig: RigDescription, link: CanLink, clock: Clock) -> tuple[str, ...]:
    """Do what `stop_rig` does over an open bus; return a sentence for each thing that was done."""
    drives = [open_drive(link, axis, name, clock) for name, axis in rig.axes.items()]
    done = [f"opened {rig.can.interface} {rig.can.channel} directly".replace("  ", " ")]
    failures = []
    for drive in drives:
        try:
            drive.quick_stop()
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
