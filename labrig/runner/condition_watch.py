"""Which conditions of a protocol are met, told from the values that a run has measured so far."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

from labrig.protocol.conditions import Condition
from labrig.record.events import ValueMeasured


@dataclass(frozen=True)
class ConditionWatch:
    """The conditions of a run; `met` are those whose value has not come back since.

    It is a fold of the measured values, so that a resumed run knows what was met before.
    """

    conditions: tuple[Condition, ...] = ()
    met: frozenset[Condition] = frozenset()

    @property
    def names(self) -> frozenset[str]:
        """The values that the conditions are on."""
        return frozenset(condition.name for condition in self.conditions)

    def add(self, measured: ValueMeasured) -> "ConditionWatch":
        """Return the watch after one more value; one that could not be measured changes nothing."""
        value = measured.value
        if value is None:
            return self
        named = [condition for condition in self.conditions if condition.name == measured.name]
        stay = {condition for condition in self.met if condition not in named or not condition.is_back(value)}
        return replace(self, met=frozenset(stay.union(other for other in named if other.holds(value))))

    def add_all(self, measured: Iterable[ValueMeasured]) -> "ConditionWatch":
        """Return the watch after several values, in the order of the record."""
        watch = self
        for event in measured:
            watch = watch.add(event)
        return watch

    def list_newly_met(self, before: "ConditionWatch") -> tuple[Condition, ...]:
        """Return the conditions that are met now and were not before, in the order of the protocol."""
        return tuple(condition for condition in self.conditions if condition in self.met - before.met)
