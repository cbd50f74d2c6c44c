"""Simulated drives on a bus that other programs can join: one of python-can's, or a simulated slcan adapter."""

from collections.abc import Callable, Iterable
from typing import Any

import can

from labrig.devices.bus import OPENING_FAILURES
from labrig.devices.clocks import SystemClock
from labrig.devices.drives.epos2 import Epos2Axis
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.simulated.slcan import SlcanAdapter
from labrig.errors import BusError, InputError

_TICK_S = 0.002
_BOOT_TIME_S = 0.26
"""Measured on a real drive, from NMT reset to boot-up frame; a client begins to wait for that after it has reset."""


def open_bus(
    interface: str, channel: str = "", port: int | None = None, bitrate: int = 1_000_000
) -> can.BusABC:
    """Open the bus on which simulated drives are served.

    Parameters
    ----------
    interface : str
        Of python-can; slcan makes a serial line, as an adapter does.
    channel : str
        Of the interface; for udp_multicast the group's address.
    port : int or None
        For udp_multicast.
    bitrate : int
        Of the bus; a serial line has none [bit/s].

    Raises
    ------
    InputError
        For an interface that python-can does not know.
    BusError
        When it cannot be opened.
    """
    if interface == "slcan":
        return SlcanAdapter()
    if interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise InputError(f"python-can knows no interface {interface}", f"it knows {known}")
    options: dict[str, Any] = {} if port is None else {"port": port}
    try:
        return can.Bus(interface=interface, channel=channel or None, bitrate=bitrate, **options)
    except OPENING_FAILURES as error:
        raise BusError(
            f"CAN interface {interface} {channel} cannot be opened: {error}",
            "check --interface and --channel, adapter and driver",
        ) from error


class ServedDrives:
    """Simulated drives on a bus, in real time.

    Parameters
    ----------
    bus : can.BusABC
        The bus; the caller closes it.
    node_ids : iterable of int
        An EPOS2 for each.
    """

    def __init__(self, bus: can.BusABC, node_ids: Iterable[int]) -> None:
        self.wire, clock = InProcessWire(), SystemClock()
        self.drives = {
            node_id: SimulatedCia402Drive(
                Epos2Axis.example(node_id), self.wire, clock, Mechanics(), boot_time_s=_BOOT_TIME_S
            )
            for node_id in node_ids
        }
        self._bus = bus
        self._end = InProcessBus(self.wire, bus.send)

    def serve(self, until: Callable[[], object]) -> None:
        """Let drives and bus exchange frames until `until` returns something true; then take the drives off.

        Parameters
        ----------
        until : callable
            Called some hundred times a second.

        Raises
        ------
        BusError
            When the bus fails.
        """
        try:
            while not until():
                message = self._bus.recv(timeout=_TICK_S)
                if message is not None:
                    self._end.send(message)
                for drive in self.drives.values():
                    drive.tick()
        except (can.CanError, OSError) as error:
            raise BusError(f"the bus failed: {error}", "start the simulation again") from error
        finally:
            for drive in self.drives.values():
                drive.unplug()
            self._end.shutdown()
