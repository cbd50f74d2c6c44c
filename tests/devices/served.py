"""Simulated drives served on a bus by a thread of the test, as `labrig devices simulate` serves them."""

import os
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from queue import Empty, SimpleQueue
from typing import Any

import can
import pytest

from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.serving import ServedDrives, open_bus
from labrig.devices.simulated.slcan import SlcanAdapter
from labrig.errors import BusError

INTERFACES = ("virtual", "udp_multicast", "slcan")
_GROUP = "239.74.163.2"
_PATIENCE_S = 60.0


@dataclass
class Served:
    """What is served, and how another bus reaches it: the arguments of `can.Bus`."""

    reached_by: dict[str, Any]
    drives: dict[int, SimulatedCia402Drive]
    bus: can.BusABC
    wire: InProcessWire
    actions: SimpleQueue[Callable[[], object]]

    def open(self) -> can.BusABC:
        """Open the other end."""
        return can.Bus(**self.reached_by)

    def do(self, action: Callable[[], object]) -> None:
        """Do something to the drives in the thread that serves them, and wait until it is done."""
        done = threading.Event()
        self.actions.put(action)
        self.actions.put(done.set)
        assert done.wait(_PATIENCE_S)


def _free_port() -> int:
    """Return a port that no other test process uses."""
    return 20_000 + os.getpid() % 40_000


def _open(interface: str) -> tuple[can.BusABC, dict[str, Any]]:
    if interface == "virtual":
        reached_by: dict[str, Any] = {"interface": "virtual", "channel": "served"}
        return can.Bus(**reached_by), reached_by
    if interface == "udp_multicast":
        reached_by = {"interface": "udp_multicast", "channel": _GROUP, "port": _free_port()}
        return _multicast(reached_by), reached_by
    server = SlcanAdapter()
    return server, {
        "interface": "slcan",
        "channel": server.path,
        "bitrate": 1_000_000,
        "sleep_after_open": 0,
    }


def _multicast(reached_by: dict[str, Any]) -> can.BusABC:
    """Open a multicast bus; the test is skipped where a frame does not come back."""
    try:
        bus = open_bus("udp_multicast", _GROUP, _free_port())
        with can.Bus(**reached_by) as probe:
            probe.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
            heard = bus.recv(5.0)
    except (BusError, can.CanError, OSError) as error:
        pytest.skip(f"no multicast on this machine: {error}")
    if heard is None:
        bus.shutdown()
        pytest.skip("no multicast on this machine: a frame that was sent did not arrive")
    return bus


@contextmanager
def served_drives(interface: str, node_ids: tuple[int, ...] = (1, 2, 3)) -> Iterator[Served]:
    """Serve simulated drives until the block is left."""
    bus, reached_by = _open(interface)
    served, over = ServedDrives(bus, node_ids), threading.Event()
    actions: SimpleQueue[Callable[[], object]] = SimpleQueue()

    def until() -> bool:
        _do_all(actions)
        return over.is_set()

    thread = threading.Thread(target=served.serve, args=(until,))
    thread.start()
    try:
        yield Served(reached_by, served.drives, bus, served.wire, actions)
    finally:
        over.set()
        thread.join()
        bus.shutdown()


def _do_all(actions: SimpleQueue[Callable[[], object]]) -> None:
    try:
        while True:
            actions.get_nowait()()
    except Empty:
        return
