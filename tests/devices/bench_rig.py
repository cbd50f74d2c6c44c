"""A bench rig whose drives are simulated ones on a python-can bus, in real time; its camera shows one picture."""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from labrig.devices.camera import Exposure, PictureSource, Setting
from labrig.devices.hardware import BenchHardware
from labrig.devices.rig import Rig
from labrig.devices.rig_file import RigDescription, load_rig
from labrig.devices.supervisor import Interrupted
from tests.devices.rigs import BENCH, Person, Signal

SCREW = ("encoder_pulses_per_turn=500", "gear_ratio=4", "limits=[-2, 120]", "acceleration=50")
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


class StillSource:
    """Takes every setting, and shows one picture."""

    def __init__(self, description: RigDescription) -> None:
        self._settings: dict[str, Setting] = {}
        self._shape = (description.camera.height_px, description.camera.width_px)

    def set(self, name: str, value: Setting) -> None:
        """Make a setting."""
        self._settings[name] = value

    def get(self, name: str) -> Setting | None:
        """Return a setting."""
        return self._settings.get(name)

    def read(self) -> Exposure | None:
        """Return the picture."""
        return Exposure(np.zeros(self._shape, np.uint8))

    def close(self) -> None:
        """Nothing is held."""


class ServedPlant(BenchHardware):
    """A real bus and clock, and a camera that shows nothing."""

    def open_source(self) -> PictureSource:
        """Return the still picture."""
        return StillSource(self._rig)


@contextmanager
def bench_rig(
    description: RigDescription, folder: Path, interrupted: Interrupted | None = None
) -> Iterator[Rig]:
    """Open a rig over the bus, connected and with no needle in tissue; it is closed without a word about power."""
    placed = description.placed_in(folder)
    hardware = ServedPlant(placed)
    link = hardware.open_link()
    try:
        rig = Rig(
            placed,
            hardware=hardware,
            link=link,
            source=hardware.open_source(),
            person=Person(),
            interrupted=interrupted or Signal(),
        )
        rig.connect()
        rig.needle.mark_out()
        yield rig
    finally:
        link.close()
        hardware.close()
