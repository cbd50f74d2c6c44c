"""Conditions of a protocol on values that a run measures."""

from collections.abc import Iterator, Mapping
from typing import Literal

from labrig.protocol.model import Conflict, Model, Name
from labrig.protocol.tree import find_closest


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


def explain_unknown_value(name: str, key: str, known: Mapping[str, str]) -> Conflict:
    """Return what is wrong with a condition on a value that the experiment does not measure.

    Parameters
    ----------
    known : mapping
        The values that it measures, by name, with what each is.
    """
    meant = find_closest(name, known)
    listed = "; ".join(f"{value}, {what}" for value, what in known.items()) or "none"
    hint = f"did you mean {meant}? " if meant else "limits of axes stand in the rig file; "
    return Conflict(key, f"no value is named {name}", f"{hint}values of this experiment: {listed}")
