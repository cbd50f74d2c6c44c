"""Simulated drives served on a bus by a thread of the test, and a bench without a camera that drives them."""

import os
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import SimpleQueue
from typing import Any

import can
import pytest

from labrig.devices.hardware import BenchHardware
from labrig.devices.opening import Opening
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive
from labrig.devices.simulated.serving import ServedDrives, open_bus
from labrig.devices.simulated.slcan import SlcanAdapter
from labrig.errors import BusError
from tests.devices.rigs import BENCH, make_rig

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

    def do(self, action: Callable[[], object]) -> None:
        """Do something to the drives in the thread that serves them, and wait until it is done."""
        done = threading.Event()
        self.actions.put(action)
        self.actions.put(done.set)
        assert done.wait(_PATIENCE_S)


def _open(interface: str) -> tuple[can.BusABC, dict[str, Any]]:
    """Open a bus; the test is skipped where a frame does not come through, as multicast on some machines."""
    if interface == "slcan":
        server = SlcanAdapter()
        to_channel = {"channel": server.path, "bitrate": 1_000_000, "sleep_after_open": 0}
        return server, {"interface": "slcan", **to_channel}
    # No other test process uses that port.
    port = {"port": 20_000 + os.getpid() % 40_000} if interface == "udp_multicast" else {}
    reached_by: dict[str, Any] = {"interface": interface, "channel": _GROUP, **port}
    try:
        bus = open_bus(interface, _GROUP, **port)
        with can.Bus(**reached_by) as probe:
            probe.send(can.Message(arbitration_id=0x7FF, is_extended_id=False))
            heard = bus.recv(5.0)
    except (BusError, can.CanError, OSError) as error:
        pytest.skip(f"no {interface} on this machine: {error}")
    if heard is None:
        bus.shutdown()
        pytest.skip(f"no {interface} on this machine: a frame that was sent did not arrive")
    return bus, reached_by


@contextmanager
def served_drives(interface: str, node_ids: tuple[int, ...] = (1, 2, 3)) -> Iterator[Served]:
    """Serve simulated drives until the block is left."""
    bus, reached_by = _open(interface)
    served, over = ServedDrives(bus, node_ids), threading.Event()
    actions: SimpleQueue[Callable[[], object]] = SimpleQueue()

    def until() -> bool:
        while not actions.empty():
            actions.get()()
        return over.is_set()

    thread = threading.Thread(target=served.serve, args=(until,))
    thread.start()
    try:
        yield Served(reached_by, served.drives, bus, served.wire, actions)
    finally:
        over.set()
        thread.join()
        bus.shutdown()


SCREW = ("counts_per_turn=2000", "gear_ratio=4", "limits=[-2, 120]", "acceleration=50")


def bench_description(reached_by: Mapping[str, object], *overrides: str) -> RigDescription:
    """Return a complete bench rig on a bus, as `can.Bus` takes its arguments; a millimetre is 4000 quadcounts."""
    bus = dict(reached_by)
    interface, channel = bus.pop("interface"), bus.pop("channel")
    bus.pop("bitrate", None)
    axes = [f"axes.{name}.{value}" for name in ("insertion", "rotation", "linear") for value in SCREW]
    leads = ["axes.insertion.lead_mm=2", "axes.linear.lead_mm=2"]
    options = [f"can.options.{name}={value}" for name, value in bus.items()]
    can = [f"can.interface={interface}", f"can.channel={channel}", *options]
    return load_rig(BENCH, (*axes, *leads, *can, *overrides))


@contextmanager
def bench_rig(description: RigDescription, folder: Path) -> Iterator[Rig]:
    """Open a rig over the bus, connected and with no needle in tissue; it is closed without a word about power."""
    placed = description.placed_in(folder)
    hardware = BenchHardware(placed)
    with closing(hardware):
        rig = make_rig(placed, hardware, Opening(camera=False))
        with closing(rig._link):
            rig.connect()
            rig.needle.mark_out()
            yield rig
