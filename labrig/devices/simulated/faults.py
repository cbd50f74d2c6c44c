"""Injects the faults that a rig file or a test scripts."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from labrig.clock import Clock
from labrig.devices.fault_script import FaultDescription
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402 import SimulatedCia402Drive


@dataclass
class FaultScript:
    """Injects each fault when it is due.

    Parameters
    ----------
    wire : InProcessWire
        The bus.
    drives : mapping of str to SimulatedCia402Drive
        The drives by their axes.
    clock : Clock
        Rig time; `tick` is to be called whenever it advances.
    waiting : tuple of FaultDescription
        The faults that are still to come.
    """

    wire: InProcessWire
    drives: Mapping[str, SimulatedCia402Drive]
    clock: Clock
    waiting: tuple[FaultDescription, ...]

    def __post_init__(self) -> None:
        """Inject what is due at once."""
        self.tick()

    def tick(self) -> None:
        """Inject what is due."""
        due = tuple(filter(self._is_due, self.waiting))
        self.waiting = tuple(fault for fault in self.waiting if fault not in due)
        for fault in due:
            self.inject(fault)

    def inject(self, fault: FaultDescription) -> None:
        """Inject a fault now."""
        if fault.axis is None:
            {"bus-off": self.wire.enter_bus_off, "unplugged": self.wire.unplug}[fault.fault]()
        else:
            _list_actions(fault, self.drives[fault.axis])[fault.fault]()

    def _is_due(self, fault: FaultDescription) -> bool:
        if self.clock.now_s() < fault.at_s:
            return False
        if fault.axis is None or fault.once == "any":
            return True
        drive = self.drives[fault.axis]
        doing = "homing" if drive.is_homing else "moving" if drive.is_moving else "idle"
        return fault.once == doing


def _list_actions(fault: FaultDescription, drive: SimulatedCia402Drive) -> dict[str, Callable[[], object]]:
    return {
        "silent": drive.mute,
        "boot-up": drive.restart,
        "emergency": lambda: drive.fail(fault.code or 0),
        "emergency-stop": drive.cut_power_stage,
        "blocked": drive.shaft.jam,
        "input": lambda: drive.set_input(str(fault.source), fault.value),
    }
