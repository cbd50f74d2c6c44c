"""Faults that a simulated rig is to have: what, on which axis, and when; a section of a rig file."""

from collections.abc import Iterable
from typing import Annotated, Literal

from pydantic import Field

from labrig.protocol.model import Conflict, Model

FaultName = Literal[
    "silent",
    "deaf",
    "boot-up",
    "emergency",
    "sdo-abort",
    "sdo-timeout",
    "following-error",
    "blocked",
    "input",
    "bus-off",
    "bus-passive",
    "lost-frames",
    "duplicated-frames",
    "late-frames",
    "unplugged",
    "node-id-clash",
    "encoder-resolution",
    "emergency-stop",
    "heartbeat-stops",
    "negative-limit-switch",
    "positive-limit-switch",
]

_OF_THE_BUS = frozenset(
    {"bus-off", "bus-passive", "lost-frames", "duplicated-frames", "late-frames", "unplugged"}
)
_NEEDS_CODE = frozenset({"emergency", "sdo-abort"})


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
    """Error code of emergency, or abort code of sdo-abort [-]."""
    count: Annotated[int, Field(ge=1, le=1_000_000)] = 1
    """Frames that are lost, duplicated or late; SDO requests without an answer [-]."""
    delay_s: Annotated[float, Field(gt=0, le=60)] = 0.1
    """How late frames arrive [s]."""
    encoder_pulses_per_turn: Annotated[int, Field(ge=16, le=2_500_000)] = 1000
    """What encoder-resolution sets the drive to [-]."""
    source: Annotated[str, Field(min_length=1, max_length=40)] | None = None
    """Input of the drive that the fault input sets: analog-1, general-A."""
    value: float = 0.0
    """What it is set to: the voltage of an analog input [mV], 1 or 0 of a digital one."""

    def conflicts(self) -> Iterable[Conflict]:
        """Yield a fault of a drive without an axis, one of the bus with one, and a missing code or source."""
        if (self.axis is None) != (self.fault in _OF_THE_BUS):
            whose = "one of the bus, it has no axis" if self.axis else "one of a drive, it needs an axis"
            yield Conflict("axis", f"the fault {self.fault} is {whose}")
        if (self.code is None) == (self.fault in _NEEDS_CODE):
            message = "needs a code" if self.code is None else "has no code"
            yield Conflict("code", f"the fault {self.fault} {message}")
        if (self.source is None) == (self.fault == "input"):
            message = "needs the source that it sets" if self.source is None else "has no source"
            yield Conflict("source", f"the fault {self.fault} {message}")
        if self.axis is None and self.once != "any":
            yield Conflict("once", "a fault of the bus waits for no axis")
