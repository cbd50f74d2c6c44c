"""Events of a run as sentences, for the log of a viewer, `labrig runs show` and the page of the run."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, Literal

from jinja2 import Environment, StrictUndefined, Template, UndefinedError

from labrig.protocol.yaml_text import load_yaml_values
from labrig.record.events import ConditionMet, Continue, MarkBad, OperatorNote, Pause, Repeat, Skip, Undo
from labrig.record.reader import Run
from labrig.report.formatting import Rows, format_value
from labrig.text import split_quantity

Level = Literal["ERROR", "WARN", "INFO", "DEBUG"]

_SENTENCES: Mapping[str, Any] = load_yaml_values(Path(__file__).with_name("event_words.yaml"))
_DECIDED = frozenset(
    model.kind for model in (Pause, Continue, Skip, Repeat, MarkBad, OperatorNote, Undo, ConditionMet)
)
_DETAILS = frozenset({"move", "move_done", "observation"})
"""Kinds that there are so many of that they hide the others."""
_HIDDEN = frozenset({"kind", "t_s", "seq", "trial"})
_COUNTED_FROM_ZERO = frozenset({"hole", "view"})
"""They count from zero on disk; people count from one."""


@dataclass(frozen=True)
class LogEntry:
    """A sentence about an event, and how much it matters."""

    text: str
    level: Level


def describe_event(event: Mapping[str, Any], words: Mapping[str, str]) -> LogEntry:
    """Return the log entry of an event.

    Parameters
    ----------
    event : Mapping
        A line of events.jsonl.
    words : Mapping
        The sentences of an experiment's own kinds, as templates over the fields of the event; a line that lacks what
        its sentence needs is written field by field.
    """
    kind = str(event.get("kind"))
    try:
        text = _compile({**_SENTENCES, **words}[kind]).render(event)
    except (KeyError, TypeError, ValueError, UndefinedError):
        text = f"{_say_plainly(kind)}: {_list_fields(event)}".removesuffix(": ")
    return LogEntry(text, _judge(kind, event))


def list_decisions(run: Run) -> Rows:
    """Return the rig time and a sentence for each thing that a person did, and each condition that was met."""
    return tuple(
        (f"at {event['t_s']:.0f} s", describe_event(event, {}).text)
        for event in run.lines("events")
        if event.get("kind") in _DECIDED
    )


def _judge(kind: str, event: Mapping[str, Any]) -> Level:
    if kind in {"run_stop", "trial_stop"}:
        return "INFO" if event.get("exit_status") == "success" else "ERROR"
    if kind in _DECIDED or any(event.get(name) is False for name in ("accepted", "believed", "confirmed")):
        return "WARN"
    return "DEBUG" if kind in _DETAILS else "INFO"


def _list_fields(fields: Mapping[str, Any]) -> str:
    """Return names and values, each with its unit; lists and what is empty are left out."""
    told = []
    for name, recorded in fields.items():
        if name not in _HIDDEN and isinstance(recorded, str | int | float) and recorded != "":
            (words, unit), value = split_quantity(name), recorded
            if unit == "rad":
                value, unit = math.degrees(float(value)), "degrees"
            value = float(f"{value:.4g}") if isinstance(value, float) else value
            if name in _COUNTED_FROM_ZERO and isinstance(value, int):
                value += 1
            told.append(f"{words} {format_value(value)} {unit or ''}".rstrip())
    return ", ".join(told)


def _say_plainly(name: str) -> str:
    """Return the name of a kind or a class in words."""
    return re.sub(r"(?<!^)(?=[A-Z])", " ", name).replace("_", " ").lower()


def _tell_place(value: float, axis: str) -> str:
    """Return a position or speed of an axis as a person reads it: angles in degrees."""
    return f"{math.degrees(value):.1f}°" if axis == "rotation" else f"{value:.2f} mm"


@lru_cache(maxsize=256)
def _compile(sentence: str) -> Template:
    return _SPEECH.from_string(sentence)


_SPEECH = Environment(undefined=StrictUndefined)  # noqa: S701 - plain text, which a page escapes like any other
_SPEECH.filters |= {
    "plain": _say_plainly,
    "fields": _list_fields,
    "place": _tell_place,
    "degrees": math.degrees,
    "norm": lambda vector: math.hypot(*vector),
}
