"""Conditions of a protocol on values that a run measures, as one line of text each: `radius_mm outside [26, 30]`.

The forms are `NAME > NUMBER`, `NAME < NUMBER`, `NAME outside [LOW, HIGH]` and `NAME inside [LOW, HIGH]`.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, TypeAlias

from labrig.protocol.formatting import find_closest
from labrig.protocol.model import Conflict

Action: TypeAlias = Literal["ask_when", "stop_when"]
"""What a condition that is met does: the run pauses, or it stops. The keys of a protocol."""

_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_FORM = re.compile(
    rf"(?P<name>[A-Za-z]\w*)\s*"
    rf"(?:(?P<sign>[<>])\s*(?P<limit>{_NUMBER})"
    rf"|\s(?P<word>outside|inside)\s*\[\s*(?P<low>{_NUMBER})\s*,\s*(?P<high>{_NUMBER})\s*\])",
    re.ASCII,
)
_FORMS = "NAME > 3, NAME < 3, NAME outside [26, 30] or NAME inside [26, 30]"

_GUARDS: Mapping[str, str] = {
    "current": "max_current_ma",
    "force": "inputs",
    "input": "inputs",
    "following": "max_following_error",
    "speed": "max_speed",
    "velocity": "max_speed",
    **dict.fromkeys(("position", "insertion", "rotation", "linear"), "limits"),
}
"""Word of a name -> key of an axis in the rig file that guards such a value."""


@dataclass(frozen=True)
class Condition:
    """A condition on a named value, and what it does.

    Attributes
    ----------
    action : Action
        What it does.
    text : str
        As the protocol has it.
    name : str
        The value.
    outside : bool
        Whether it is met outside of the interval; otherwise within.
    low, high : float
        The interval, in the unit of the name; one end is infinite for `>` and `<`.
    """

    action: Action
    text: str
    name: str
    outside: bool
    low: float
    high: float

    def holds(self, value: float) -> bool:
        """Return whether a value meets the condition."""
        return self.outside != (self.low <= value <= self.high)


def parse_condition(text: str, action: Action) -> Condition:
    """Return the condition that a text states.

    Raises
    ------
    ValueError
        When it has none of the forms, a number is not finite, or its interval is empty.
    """
    found = _FORM.fullmatch(text.strip())
    if found is None:
        raise ValueError(f'"{text}" is not a condition, expected {_FORMS}')
    numbers = {key: float(found[key]) for key in ("limit", "low", "high") if found[key]}
    if not all(math.isfinite(value) for value in numbers.values()):
        raise ValueError(f'"{text}" has a number that is not finite')
    low, high = numbers.get("low", -math.inf), numbers.get("high", math.inf)
    if found["sign"] == ">":
        high = numbers["limit"]
    elif found["sign"] == "<":
        low = numbers["limit"]
    outside = found["word"] != "inside"
    if low >= high:
        raise ValueError(f'"{text}": the interval is empty, {low:g} must be below {high:g}')
    return Condition(action, text.strip(), found["name"], outside, low, high)


def find_fault(text: str, key: str, known: Mapping[str, str]) -> Conflict | None:
    """Return what is wrong with a condition of a protocol; None if nothing is.

    Parameters
    ----------
    text : str
        The condition.
    key : str
        Its key, such as `ask_when.0`.
    known : mapping
        The values that the experiment measures, by name, with what each is.
    """
    try:
        name = parse_condition(text, "ask_when").name
    except ValueError as error:
        return Conflict(key, str(error), _list_known(known))
    if name in known:
        return None
    guard = next((guard for word, guard in _GUARDS.items() if word in name.casefold().split("_")), None)
    if guard is not None:
        hint = "a limit there stops the axes at once, a condition is judged between insertions"
        return Conflict(
            key,
            f"{name} is guarded by the rig file's limits: axes.*.{guard}",
            f"{hint}; {_list_known(known)}",
        )
    meant = find_closest(name, known)
    hint = f"did you mean {meant}? {_list_known(known)}" if meant else _list_known(known)
    return Conflict(key, f"no value is named {name}", hint)


def _list_known(known: Mapping[str, str]) -> str:
    return (
        f"values of this experiment: {'; '.join(f'{name}, {what}' for name, what in known.items()) or 'none'}"
    )
