"""A bench rig without its camera, whose drives are simulated ones on a python-can bus, in real time."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from labrig.devices.hardware import BenchHardware
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.supervisor import Interrupted
from tests.devices.rigs import BENCH, Person, Signal

SCREW = ("counts_per_turn=2000", "gear_ratio=4", "limits=[-2, 120]", "acceleration=50")
PATIENT = ("can.answer_timeout_ms=5000", "can.heartbeat.timeout_ms=10000")
"""For tests that say nothing of time: nothing fails on a machine that is busy with something else."""


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
def bench_rig(
    description: RigDescription, folder: Path, interrupted: Interrupted | None = None
) -> Iterator[Rig]:
    """Open a rig over the bus, connected and with no needle in tissue; it is closed without a word about power."""
    placed = description.placed_in(folder)
    hardware = BenchHardware(placed)
    link = hardware.open_link()
    try:
        rig = Rig(
            placed,
            hardware=hardware,
            link=link,
            source=None,
            person=Person(),
            interrupted=interrupted or Signal(),
        )
        rig.connect()
        rig.needle.mark_out()
        yield rig
    finally:
        link.close()
        hardware.close()
