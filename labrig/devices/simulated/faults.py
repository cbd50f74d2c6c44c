"""Injects the faults that a rig file or a test scripts."""

from collections.abc import Callable, Iterable, Mapping

from labrig.clock import Clock
from labrig.devices.fault_script import FaultDescription
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.simulated_node import SimulatedNode


class FaultScript:
    """Injects each fault when it is due.

    Parameters
    ----------
    wire : InProcessWire
        The bus.
    drives : mapping of str to SimulatedNode
        The drives by their axes.
    clock : Clock
        Rig time; `tick` is to be called whenever it advances.
    faults : iterable of FaultDescription
        The faults.
    """

    def __init__(
        self,
        wire: InProcessWire,
        drives: Mapping[str, SimulatedNode],
        clock: Clock,
        faults: Iterable[FaultDescription],
    ) -> None:
        self._wire = wire
        self._drives = drives
        self._clock = clock
        self._waiting = list(faults)
        self.happened: list[tuple[float, FaultDescription]] = []
        """Faults injected so far, each with its rig time."""
        self.tick()

    def tick(self) -> None:
        """Inject what is due."""
        if not self._waiting:
            return
        due = [fault for fault in self._waiting if self._is_due(fault)]
        self._waiting = [fault for fault in self._waiting if fault not in due]
        for fault in due:
            self.inject(fault)

    def inject(self, fault: FaultDescription) -> None:
        """Inject a fault now."""
        self.happened.append((self._clock.now_s(), fault))
        if fault.axis is None:
            {"bus-off": self._wire.enter_bus_off, "unplugged": self._wire.unplug}[fault.fault]()
        else:
            _list_actions(fault, self._drives[fault.axis])[fault.fault]()

    def _is_due(self, fault: FaultDescription) -> bool:
        if self._clock.now_s() < fault.at_s:
            return False
        if fault.axis is None or fault.once == "any":
            return True
        drive = self._drives[fault.axis]
        doing = "homing" if drive.is_homing else "moving" if drive.is_moving else "idle"
        return fault.once == doing


def _list_actions(fault: FaultDescription, drive: SimulatedNode) -> dict[str, Callable[[], object]]:
    return {
        "silent": drive.mute,
        "boot-up": drive.restart,
        "emergency": lambda: drive.fail(fault.code or 0),
        "emergency-stop": drive.cut_power_stage,
        "blocked": drive.block,
        "input": lambda: drive.set_input(str(fault.source), fault.value),
    }
