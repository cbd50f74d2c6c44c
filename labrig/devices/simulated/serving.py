"""Simulated drives on a bus that other programs can join, through python-can or a simulated slcan adapter."""

import json
from collections.abc import Callable, Collection, Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import can

from labrig.devices.bus import OPENING_FAILURES
from labrig.devices.clocks import SystemClock
from labrig.devices.drive import DEFAULT_DRIVER, find_drive_kind
from labrig.devices.simulated.bus import InProcessBus, InProcessWire
from labrig.devices.simulated.shaft import Mechanics
from labrig.devices.simulated.simulated_node import SimulatedNode
from labrig.devices.simulated.slcan_adapter import SlcanAdapter
from labrig.durable import write_atomically
from labrig.errors import BusError, InputError

_TICK_S = 0.002
_MOST_FRAMES = 200
"""Frames in a round, ten times as many as a bus of 1 Mbit/s carries in a tick: a flood does not stop the drives."""

BOOT_TIME_S = 0.26
"""Measured on a real drive, from NMT reset to boot-up frame."""

_BITRATES = (10_000, 20_000, 50_000, 125_000, 250_000, 500_000, 800_000, 1_000_000)


@dataclass(frozen=True)
class ServedBus:
    """The bus on which simulated drives are served.

    Parameters
    ----------
    interface : str
        Of python-can; slcan makes a pseudo-terminal of its own.
    channel : str
        Of the interface; for udp_multicast the group's address.
    port : int or None
        For udp_multicast.
    bitrate : int
        Of the bus [bit/s].
    """

    interface: str
    channel: str = ""
    port: int | None = None
    bitrate: int = 1_000_000

    def open(self) -> can.BusABC:
        """Open it.

        Raises
        ------
        InputError
            For an interface that no other program can join or that python-can does not know.
        BusError
            When it cannot be opened.
        """
        if self.interface == "virtual":
            raise InputError(
                "the interface virtual ends with the process, nobody could reach the drives",
                "use udp_multicast or slcan",
            )
        if self.bitrate not in _BITRATES:
            known = ", ".join(map(str, _BITRATES))
            raise InputError(f"bit rate {self.bitrate} is not one that drives have", f"use one of {known}")
        if self.interface == "slcan":
            return SlcanAdapter(self.bitrate)
        if self.interface not in can.VALID_INTERFACES:
            known = ", ".join(sorted(can.VALID_INTERFACES))
            raise InputError(f"python-can knows no interface {self.interface}", f"it knows {known}")
        options: dict[str, Any] = {} if self.port is None else {"port": self.port}
        try:
            return can.Bus(
                interface=self.interface, channel=self.channel or None, bitrate=self.bitrate, **options
            )
        except OPENING_FAILURES as error:
            raise BusError(
                f"CAN interface {self.interface} {self.channel} cannot be opened: {error}",
                "check --interface and --channel, adapter and driver",
            ) from error


class Gateway:
    """Passes frames between the wire of simulated drives and a bus that other programs can join.

    Parameters
    ----------
    bus : can.BusABC
        The bus; the caller closes it.
    """

    def __init__(self, bus: can.BusABC) -> None:
        self.wire = InProcessWire()
        self._bus = bus
        self._end = InProcessBus(self.wire, bus.send)

    def serve(
        self, drives: Collection[SimulatedNode], until: Callable[[], object], tick: Callable[[], None]
    ) -> None:
        """Pass frames until `until` returns something true, some hundred times a second; then take the drives off.

        Parameters
        ----------
        drives : collection of SimulatedNode
            The drives on the wire.
        until : callable
            Called before each round.
        tick : callable
            Called at the end of each round.

        Raises
        ------
        BusError
            When the bus fails.
        """
        try:
            while not until():
                self._pass_frames()
                for drive in drives:
                    drive.tick()
                tick()
        except (can.CanError, OSError) as error:
            raise BusError(f"the bus failed: {error}", "start the simulation again") from error
        finally:
            for drive in drives:
                drive.unplug()
            self._end.shutdown()

    def _pass_frames(self) -> None:
        """Wait for a frame for a tick, and pass on what has arrived, but no more than a bus could carry."""
        message, passed = self._bus.recv(timeout=_TICK_S), 0
        while message is not None:
            self._end.send(message)
            passed += 1
            message = self._bus.recv(timeout=0) if passed < _MOST_FRAMES else None


class ServedDrives:
    """Simulated drives on a bus, in real time.

    Parameters
    ----------
    bus : can.BusABC
        The bus; the caller closes it.
    node_ids : iterable of int
        A drive for each.
    driver : str
        Kind of the drives.
    """

    def __init__(self, bus: can.BusABC, node_ids: Iterable[int], driver: str = DEFAULT_DRIVER) -> None:
        self._gateway = Gateway(bus)
        self.wire, clock = self._gateway.wire, SystemClock()
        kind = find_drive_kind(driver)
        self.drives = {
            node_id: kind.simulate(kind.example_section(node_id), self.wire, clock, Mechanics(), BOOT_TIME_S)
            for node_id in node_ids
        }

    def serve(self, until: Callable[[], object]) -> None:
        """Let drives and bus exchange frames until `until` returns something true. Raises `BusError`."""
        self._gateway.serve(self.drives.values(), until, lambda: None)


def write_journal(path: Path, drives: Iterable[SimulatedNode]) -> None:
    """Write the events of all drives with their node ids, in order of time, a JSON line each. Raises `DiskError`."""
    noted = [(drive.node_id, event) for drive in drives for event in drive.journal]
    noted.sort(key=lambda pair: pair[1].t_s)
    lines = [json.dumps({"node_id": node_id, **event.document()}) for node_id, event in noted]
    write_atomically(path, "".join(line + "\n" for line in lines).encode())


def serve_drives(
    served: ServedBus,
    node_ids: Iterable[int],
    *,
    until: Callable[[], object],
    ready: Callable[[str], None],
    journal: Path | None = None,
) -> None:
    """Serve simulated drives until `until` returns something true.

    Parameters
    ----------
    served : ServedBus
        The bus.
    node_ids : iterable of int
        A drive for each.
    until : callable
        Called some hundred times a second.
    ready : callable
        Called with the channel by which other programs reach the drives, once they can.
    journal : Path or None
        File for the events of the drives, a JSON line for each, written at the end.

    Raises
    ------
    InputError, BusError, DiskError
    """
    with served.open() as bus:
        drives = ServedDrives(bus, node_ids)
        ready(bus.path if isinstance(bus, SlcanAdapter) else served.channel)
        try:
            drives.serve(until)
        finally:
            if journal is not None:
                write_journal(journal, drives.drives.values())
