"""Conditions of a protocol on values that a run measures."""

from collections.abc import Iterator
from typing import Literal

from labrig.protocol.model import Conflict, Model, Name


class Condition(Model):
    """A value of a trial beyond which the run asks its person, or stops, once the needle is out again."""

    value: Name
    """Name of the value."""
    below: float | None = None
    """The condition is met below this; null: not judged."""
    above: float | None = None
    """The condition is met above this; null: not judged."""
    do: Literal["ask", "stop"] = "ask"
    """What the run does then: pause and ask, or stop."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a condition that no value meets, or every value."""
        if self.below is None and self.above is None:
            yield Conflict("value", f"{self.value} is judged by no limit", "give below, above, or both")
        elif self.below is not None and self.above is not None and self.below > self.above:
            message = f"below is {self.below:g}, must be at most above, {self.above:g}"
            yield Conflict("below", message, "every value would meet the condition")

    def __str__(self) -> str:
        """Return the condition in words: radius_mm below 26 or above 30."""
        limits = (("below", self.below), ("above", self.above))
        return f"{self.value} " + " or ".join(f"{word} {at:g}" for word, at in limits if at is not None)

    def holds(self, value: float) -> bool:
        """Return whether a value meets the condition."""
        return (self.below is not None and value < self.below) or (
            self.above is not None and value > self.above
        )
