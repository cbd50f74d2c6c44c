"""A simulated stepper drive: a node on a bus with the state machine, faults and motion of CiA 402."""

from typing import ClassVar

from labrig.clock import Clock
from labrig.devices import canopen_objects as co
from labrig.devices.homing import HOMING_HERE
from labrig.devices.simulated.bus import InProcessWire
from labrig.devices.simulated.cia402_node import SimulatedCia402Drive
from labrig.devices.simulated.dictionary import ObjectTable
from labrig.devices.simulated.shaft import Mechanics
from labrig_example.stepper.driver import PRODUCT, VENDOR
from labrig_example.stepper.settings import StepperAxis

_OBJECTS = ObjectTable(b"example stepper", co.STANDARD)


class SimulatedStepper(SimulatedCia402Drive):
    """One stepper drive."""

    homing_methods: ClassVar[frozenset[int]] = frozenset({HOMING_HERE})

    def __init__(
        self,
        wire: InProcessWire,
        section: StepperAxis,
        clock: Clock,
        mechanics: Mechanics,
        boot_time_s: float = 0.0,
    ) -> None:
        self._section = section
        fixed = {
            co.VENDOR_ID: VENDOR,
            co.PRODUCT_CODE: PRODUCT,
            co.SERIAL_NUMBER: 7000 + section.node_id,
            co.HOMING_METHOD: HOMING_HERE,
        }
        super().__init__(
            wire,
            section.node_id,
            clock,
            table=_OBJECTS,
            fixed=fixed,
            mechanics=mechanics,
            boot_time_s=boot_time_s,
        )

    def counts_per_turn(self) -> int:
        """Return the microsteps per turn of the motor."""
        return self._section.microsteps_per_turn

    def error_register(self, code: int) -> int:  # noqa: ARG002 - the same for every error
        """Return the bits that an error sets: the generic one."""
        return 0x01

    def add_twin(self) -> None:
        """Put another drive with the same node id on the bus."""
        SimulatedStepper(self._wire, self._section, self._clock, self._shaft.mechanics)

    def set_encoder(self, pulses: int) -> None:
        """Change the microsteps per turn."""
        self._section = self._section.model_copy(update={"microsteps_per_turn": pulses})
