"""Simulated drives served on a bus by a thread of the test, as `labrig devices simulate` serves them."""

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import can

from labrig.devices.simulated.drive import SimulatedDrive
from labrig.devices.simulated.serving import ServedBus, ServedDrives
from labrig.devices.simulated.slcan_adapter import SlcanAdapter

INTERFACES = ("virtual", "udp_multicast", "slcan")
_GROUP = "239.74.163.2"


@dataclass
class Served:
    """What is served, and how another bus reaches it: the arguments of `can.Bus`."""

    reached_by: dict[str, object]
    drives: dict[int, SimulatedDrive]
    bus: can.BusABC

    def open(self) -> can.BusABC:
        """Open the other end."""
        return can.Bus(**self.reached_by)


def _free_port() -> int:
    """Return a port that no other test process uses."""
    return 20_000 + os.getpid() % 40_000


def _open(interface: str) -> tuple[can.BusABC, dict[str, object]]:
    if interface == "virtual":
        reached_by: dict[str, object] = {"interface": "virtual", "channel": "served"}
        return can.Bus(**reached_by), reached_by
    if interface == "udp_multicast":
        port = _free_port()
        bus = ServedBus("udp_multicast", _GROUP, port).open()
        return bus, {"interface": "udp_multicast", "channel": _GROUP, "port": port}
    adapter = SlcanAdapter(1_000_000)
    return adapter, {
        "interface": "slcan",
        "channel": adapter.path,
        "bitrate": 1_000_000,
        "sleep_after_open": 0,
    }


@contextmanager
def served_drives(interface: str, node_ids: tuple[int, ...] = (1, 2, 3)) -> Iterator[Served]:
    """Serve simulated drives until the block is left."""
    bus, reached_by = _open(interface)
    served, over = ServedDrives(bus, node_ids), threading.Event()
    thread = threading.Thread(target=served.serve, args=(over.is_set,))
    thread.start()
    try:
        yield Served(reached_by, served.drives, bus)
    finally:
        over.set()
        thread.join()
        bus.shutdown()
