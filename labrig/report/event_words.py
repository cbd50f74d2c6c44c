"""Events of a run as sentences for the log of a viewer."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal

from labrig.record.events import (
    Continue,
    Event,
    Move,
    MoveDone,
    OperatorQuestion,
    RunResume,
    RunStart,
    ValueMeasured,
    WithdrawalStart,
    WithdrawalStop,
)
from labrig.record.layout import RUN_STOP, TRIAL_START, TRIAL_STOP
from labrig.report.decisions import TOLD, describe_decision
from labrig.report.view import Words

Level = Literal["ERROR", "WARN", "INFO", "DEBUG"]

_UNITS = {
    "mm": "mm", "s": "s", "rad": "rad", "deg": "°", "px": "px", "percent": "%", "mm_s": "mm/s", "rad_s": "rad/s",
}  # fmt: skip
_ENDED_WELL = frozenset({"success"})
_DETAILS = frozenset({Move.kind, MoveDone.kind, "observation"})
"""Kinds that there are so many of that they hide the others."""
_DECIDED = frozenset(model.kind for model in TOLD)
_HIDDEN = frozenset({"kind", "t_s", "seq", "trial"})
_COUNTED_FROM_ZERO = frozenset({"hole", "view"})
"""Details of a question that count from zero on disk; people count from one, as the question did."""


@dataclass(frozen=True)
class LogEntry:
    """A sentence about an event, and how much it matters."""

    text: str
    level: Level


def describe_event(event: Mapping[str, Any], words: Mapping[str, Words]) -> LogEntry:
    """Return the log entry of an event.

    Parameters
    ----------
    event : Mapping
        A line of events.jsonl.
    words : Mapping
        The sentences of an experiment's own kinds; a line that lacks what its sentence needs is written field by field.
    """
    kind = str(event.get("kind"))
    say = {**_WORDS, **words}.get(kind, _list_fields)
    try:
        text = say(event)
    except (KeyError, TypeError, ValueError):
        text = _list_fields(event)
    return LogEntry(text, _judge(kind, event))


def _judge(kind: str, event: Mapping[str, Any]) -> Level:
    if kind in {RUN_STOP, TRIAL_STOP}:
        return "INFO" if event.get("exit_status") in _ENDED_WELL else "ERROR"
    doubted = any(event.get(name) is False for name in ("accepted", "believed", "confirmed"))
    if doubted or kind in _DECIDED:
        return "WARN"
    return "DEBUG" if kind in _DETAILS else "INFO"


def _list_fields(event: Mapping[str, Any]) -> str:
    """Return kind and fields of an event, each value with its unit."""
    fields = [
        f"{_split_unit(name)[0]} {_format(value, _split_unit(name)[1])}"
        for name, value in event.items()
        if name not in _HIDDEN and isinstance(value, str | int | float) and value != ""
    ]
    return f"{_plain(str(event.get('kind')))}{': ' if fields else ''}{', '.join(fields)}"


def _split_unit(name: str) -> tuple[str, str]:
    """Return the words of a field's name, and its unit."""
    for unit in sorted(_UNITS, key=len, reverse=True):
        if name.endswith(f"_{unit}"):
            return _plain(name.removesuffix(f"_{unit}")), _UNITS[unit]
    return _plain(name), ""


def _format(value: object, unit: str) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    text = f"{value:.4g}" if isinstance(value, float) else str(value)
    return f"{text} {unit}".rstrip()


def _plain(name: str) -> str:
    return name.replace("_", " ")


def _describe_stop(event: Mapping[str, Any]) -> str:
    ended = "run succeeded" if event["exit_status"] == "success" else f"run {event['exit_status']}"
    return f"{ended}: {event['reason']}" if event["reason"] else ended


def _describe_trial_start(event: Mapping[str, Any]) -> str:
    hole = f", hole {event['hole'] + 1}" if "hole" in event else ""
    gel = f" in {event['specimen']}" if "specimen" in event else ""
    return f"trial {event['trial'] + 1} begins{gel}{hole}"


def _describe_trial_stop(event: Mapping[str, Any]) -> str:
    return f"trial {event['trial'] + 1}: {event['exit_status']}"


def _describe_question(event: Mapping[str, Any]) -> str:
    asked = "".join(
        f" {letter.lower()}" if letter.isupper() else letter for letter in event["request"]
    ).strip()
    details = ", ".join(
        _describe_detail(name, value)
        for name, value in event["details"].items()
        if isinstance(value, str | int | float)
    )
    answer = f": {event['answer']}" if event["answer"] else ""
    told = event.get("choice") or ("confirmed" if event["confirmed"] else "refused")
    return f"operator: {_plain(told)} “{asked}{f' ({details})' if details else ''}”{answer}"


def _describe_detail(name: str, value: str | float) -> str:
    """Return a text as it is, and a number with its name and unit."""
    if isinstance(value, str):
        return value
    words, unit = _split_unit(name)
    return f"{words} {_format(value + 1 if name in _COUNTED_FROM_ZERO else value, unit)}"


def _describe_position(event: Mapping[str, Any], name: str) -> str:
    """Return a position or speed of an axis as a person reads it: angles in degrees."""
    if event["axis"] == "rotation":
        return f"{math.degrees(event[name]):.1f}°"
    return f"{event[name]:.2f} mm"


def _describe_move(event: Mapping[str, Any]) -> str:
    speed = _describe_position(event, "speed")
    return f"{event['axis']} moves to {_describe_position(event, 'position')} at {speed}/s"


def _describe_arrival(event: Mapping[str, Any]) -> str:
    return f"{event['axis']} is at {_describe_position(event, 'position')}"


def _describe_value(event: Mapping[str, Any]) -> str:
    name, value = event["name"], event["value"]
    if value is None:
        return f"{name} of trial {event['trial'] + 1} could not be measured: {event['reason']}"
    return f"{name} of trial {event['trial'] + 1} is {value:.4g}"


def _describe_decision(model: type[Event], event: Mapping[str, Any]) -> str:
    return describe_decision(model.read(event))


_WORDS: Mapping[str, Words] = {
    RunStart.kind: lambda event: f"run starts: {event['experiment']}",
    RunResume.kind: lambda event: f"run goes on: {event['experiment']}",
    RUN_STOP: _describe_stop,
    TRIAL_START: _describe_trial_start,
    TRIAL_STOP: _describe_trial_stop,
    OperatorQuestion.kind: _describe_question,
    Move.kind: _describe_move,
    MoveDone.kind: _describe_arrival,
    WithdrawalStart.kind: lambda event: f"needle is withdrawn in {event['moves']} moves",
    **{model.kind: partial(_describe_decision, model) for model in TOLD},
    ValueMeasured.kind: _describe_value,
    Continue.kind: lambda event: f"goes on after the pause, by {event['by']}",
    WithdrawalStop.kind: lambda _event: "needle is out",
}
