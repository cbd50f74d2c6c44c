"""Faults that a simulated rig is to have: what, on which axis, and when; a section of a rig file."""

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field

from labrig.protocol.model import Conflict, Model

FaultName = Literal[
    "silent", "boot-up", "emergency", "emergency-stop", "blocked", "input",
    "bus-off", "unplugged",
]  # fmt: skip

_OF_THE_BUS = frozenset({"bus-off", "unplugged"})


class FaultDescription(Model):
    """One fault of a simulated rig."""

    fault: FaultName
    """What goes wrong."""
    axis: Literal["insertion", "rotation", "linear"] | None = None
    """Whose drive has it. null: the fault is one of the bus."""
    at_s: Annotated[float, Field(ge=0, le=1e6)] = 0.0
    """Rig time, at the earliest [s]."""
    once: Literal["any", "idle", "moving", "homing"] = "any"
    """Waits further until the axis is doing this."""
    code: Annotated[int, Field(ge=0, le=0xFFFFFFFF)] | None = None
    """Error code of an emergency [-]."""
    source: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    """Input of the drive that the fault input sets: analog-1, general-A."""
    value: float = 0.0
    """What it is set to: the voltage of an analog input [mV], 1 or 0 of a digital one."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield a fault of a drive without an axis, one of the bus with one, and a missing code or source."""
        if (self.axis is None) != (self.fault in _OF_THE_BUS):
            whose = "one of the bus, it has no axis" if self.axis else "one of a drive, it needs an axis"
            yield Conflict("axis", f"the fault {self.fault} is {whose}")
        for key, value, fault in (("code", self.code, "emergency"), ("source", self.source, "input")):
            if (value is None) == (self.fault == fault):
                has = "needs a" if value is None else "has no"
                yield Conflict(key, f"the fault {self.fault} {has} {key}")
        if self.axis is None and self.once != "any":
            yield Conflict("once", "a fault of the bus waits for no axis")
