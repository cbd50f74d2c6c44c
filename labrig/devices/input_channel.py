"""Analog and digital inputs of a drive that a rig file names: what is wired to them, and what stops a run."""

import math
from collections.abc import Iterable
from typing import Annotated

from pydantic import Field

from labrig.errors import INPUT_BEYOND_LIMIT, ForceGuardError
from labrig.protocol.model import Conflict, Interval, Model

ANALOG = "analog-"
"""Begins the name of an analog input of a drive."""

InputValue = float | bool
"""What an input reads: a number in its unit, or whether it is on."""

ChannelName = Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,30}$")]
"""Name of a channel, which is part of the names of columns."""


class InputChannel(Model):
    """One input of a drive, and what is wired to it."""

    source: Annotated[str, Field(min_length=1, max_length=40)]
    """Input of the drive: analog-1, analog-2, or a digital input by the name that labrig devices check lists,
    such as general-A."""
    unit: Annotated[str, Field(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,15}$")] | None = None
    """Unit of an analog input, as in the names of columns: N, mNm, bar."""
    units_per_volt: float | None = None
    """Scale of an analog input: unit a volt, negative where the sensor is turned round."""
    zero_v: float = 0.0
    """Voltage of an analog input at which its value is zero [V]."""
    limits: Interval | None = None
    """Lowest and highest value of an analog input at which a run goes on [unit]. null: only recorded."""
    expected: bool | None = None
    """State of a digital input, true for on, without which a run stops: a closed door, a closed
    emergency-stop chain. null: only recorded."""

    @property
    def is_analog(self) -> bool:
        """Whether it is an analog input."""
        return self.source.startswith(ANALOG)

    def conflicts(self) -> Iterable[Conflict]:
        """Yield keys of the other kind of input, and those that an analog one lacks."""
        analog = {"unit": self.unit, "units_per_volt": self.units_per_volt}
        wrong = {"expected": self.expected} if self.is_analog else {**analog, "limits": self.limits}
        kind = "an analog" if self.is_analog else "a digital"
        for key, value in wrong.items():
            if value is not None:
                yield Conflict(key, f"{key} is given, and {self.source} is {kind} input", "leave it out")
        for key, value in analog.items():
            if self.is_analog and not value:
                yield Conflict(
                    key, f"{key} is missing or zero for {self.source}", "take it from the sensor's data sheet"
                )

    def convert(self, volts: float) -> float:
        """Return the value of an analog input at a voltage [unit]."""
        return (volts - self.zero_v) * (self.units_per_volt or 0.0)

    def column(self, name: str) -> str:
        """Return the column in which a record has this channel."""
        return f"input_{name}_{self.unit}" if self.is_analog else f"input_{name}"

    def format_value(self, value: InputValue) -> str:
        """Return a value as a person reads it."""
        if isinstance(value, bool):
            return "on" if value else "off"
        return f"{value:.3g} {self.unit}"

    def format_limits(self) -> str:
        """Return what a run requires of it, for a sentence; empty if it is only recorded."""
        if self.limits is not None:
            return f"limits [{self.limits[0]:g}, {self.limits[1]:g}] {self.unit}"
        return "" if self.expected is None else f"expected {self.format_value(self.expected)}"

    def find_excess(self, name: str, axis: str, value: InputValue) -> ForceGuardError | None:
        """Return the error of a value at which a run may not go on.

        Parameters
        ----------
        name, axis : str
            The channel, and the axis to whose drive it is wired.
        value : float or bool
            What it reads.
        """
        low, high = self.limits or (-math.inf, math.inf)
        if self.expected in {None, value} if isinstance(value, bool) else low <= value <= high:
            return None
        return ForceGuardError(
            f"input {name} is {self.format_value(value)}, {self.format_limits()} "
            f"({self.source} of the drive of axis {axis})",
            f"find out what {name} shows before anything moves again; its limits are in the rig file, "
            f"axes.{axis}.inputs.{name}",
            fault=INPUT_BEYOND_LIMIT,
        )
