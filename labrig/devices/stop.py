"""Stopping a rig from outside, when nothing is known of what it is doing."""

from contextlib import closing

from labrig.clock import Clock
from labrig.devices.bus import CanLink, open_can
from labrig.devices.clocks import SystemClock
from labrig.devices.epos2 import Epos2
from labrig.devices.rig_file import ONLY_SIMULATED, RigDescription
from labrig.errors import MachineError, SafetyStopError

_STOP_TIME_S = 3.0
_NMT_STOP_ALL = bytes([0x02, 0x00])


def stop_rig(rig: RigDescription) -> tuple[str, ...]:
    """Open the bus, quick-stop every drive, see that each stands still, and send NMT stop to all.

    Nothing of the rig file is needed but bus and node ids, so that an incomplete one will do. Every drive is
    told to stop before any is waited for.

    Returns
    -------
    tuple of str
        What was done, a sentence each.

    Raises
    ------
    BusError
        When the bus cannot be reached.
    SafetyStopError
        When a drive is not known to stand still; names each and what was done.
    """
    if rig.can.interface == ONLY_SIMULATED:
        return (
            f"{rig.name} is simulated: its drives live inside the labrig that runs them; interrupt that one",
        )
    clock = SystemClock()
    with closing(open_can(rig.can, clock)) as link:
        return stop_drives(rig, link, clock)


def stop_drives(rig: RigDescription, link: CanLink, clock: Clock) -> tuple[str, ...]:
    """Do what `stop_rig` does over an open bus."""
    drives = [Epos2(link, axis.node_id, name, clock) for name, axis in rig.axes.items()]
    done = [f"opened {rig.can.interface} {rig.can.channel} directly".replace("  ", " ")]
    failures = []
    for drive in drives:
        try:
            drive.quick_stop()
        except MachineError as error:
            failures.append(error.message)
    for drive in drives:
        try:
            drive.wait_until_still(_STOP_TIME_S)
            done.append(f"{drive.name} stands still")
        except MachineError as error:
            failures.append(error.message)
    link.send(0x000, _NMT_STOP_ALL)
    done.append("sent NMT stop to all nodes")
    if failures:
        raise SafetyStopError(
            f"not known to stand still: {'; '.join(dict.fromkeys(failures))}; {'; '.join(done)}",
            "press the emergency stop",
        )
    return tuple(done)
