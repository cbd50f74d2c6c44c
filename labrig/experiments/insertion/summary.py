"""What a terminal shows of insertions to a target, and of what another setting would have told them."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import zip_longest
from typing import Any

from labrig.analysis.summary import ResultComparison, Summary, TextTable
from labrig.text import number

_HEADS = ("insertion", "outcome", "error mm", "true error mm", "true clearance mm", "length mm", "replans")
_COMMAND = ("roll_rad", "observe_at_mm", "run_to_mm", "stop")


@dataclass(frozen=True)
class CommandDivergence:
    """The first command that differs: after which picture (None: before the first), at which depth, both values."""

    frame: int | None
    depth_mm: float
    what: str
    old: float | str | None
    new: float | str | None


@dataclass(frozen=True)
class SteeringSummary:
    """An insertion as one set of settings tells it: turns asked for, paths found after the first, the first stop.

    `tip_mm` is where the tip is estimated at the last picture, (y, z); None where there is no picture.
    """

    turns: int
    replans: int
    stop: str | None
    tip_mm: tuple[float, float] | None
    turns_at_mm: tuple[float, ...]


@dataclass(frozen=True)
class WhatIf:
    """One insertion as two results tell it; `divergence` is None where both give the same commands throughout."""

    trial: int
    old: SteeringSummary
    new: SteeringSummary
    divergence: CommandDivergence | None


def compare_steering(old: Mapping[str, Any], new: Mapping[str, Any]) -> tuple[WhatIf, ...]:
    """Compare what two results of an insertion run tell, insertion by insertion.

    Parameters
    ----------
    old, new : Mapping
        Their documents. An insertion that is missing in one of them, or whose commands an older labrig did not
        record, is left out; so are results of other experiments.
    """
    before = {trial["trial"]: trial for trial in old.get("insertions", ()) if trial.get("commands")}
    after = {trial["trial"]: trial for trial in new.get("insertions", ()) if trial.get("commands")}
    return tuple(_compare_trials(before[trial], after[trial]) for trial in after if trial in before)


def _compare_trials(old: Mapping[str, Any], new: Mapping[str, Any]) -> WhatIf:
    divergence = _first_divergence(old["commands"], new["commands"])
    return WhatIf(new["trial"], summarise_steering(old), summarise_steering(new), divergence)


def summarise_steering(insertion: Mapping[str, Any]) -> SteeringSummary:
    """Return the commands of an insertion in brief; an older labrig did not record them."""
    commands, steps = insertion["commands"], insertion["steps"]
    turns = tuple(command["depth_mm"] for command in commands if command["roll_rad"] != 0.0)
    last, tip = commands[-1], steps[-1]["estimate_mm"] if steps else None
    return SteeringSummary(len(turns), last["replans"], last["stop"], tip and (tip[0], tip[1]), turns)


def _first_divergence(
    old: Sequence[Mapping[str, Any]], new: Sequence[Mapping[str, Any]]
) -> CommandDivergence | None:
    nothing = dict.fromkeys(_COMMAND)
    for before, after in zip_longest(old, new):
        there = after or before
        for what in _COMMAND:
            old_value, new_value = (before or nothing)[what], (after or nothing)[what]
            if old_value != new_value:
                return CommandDivergence(there["frame"], there["depth_mm"], what, old_value, new_value)
    return None


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return a row an insertion, and how many arrived."""
    trials = document["insertions"]
    rows = tuple(
        (
            trial["trial"] + 1,
            trial["outcome"],
            number(trial["target_error_mm"]),
            number(trial["true_target_error_mm"]),
            number(trial["true_min_clearance_mm"]),
            number(trial["length_mm"], 1),
            trial["replans"],
        )
        for trial in trials
    )
    arrived = f"{document['arrived']} of {document['made']} reached the target"
    values: dict[str, object] = {"target reached": f"{document['arrived']} of {document['made']}"}
    for trial in trials:
        values |= _values(trial)
    return Summary((TextTable(_HEADS, rows), arrived), values)


def _values(trial: Mapping[str, Any]) -> dict[str, object]:
    name = f"insertion {trial['trial'] + 1}"
    values = {
        f"{name}: error mm": trial["target_error_mm"],
        f"{name}: error by the estimate mm": trial["template_error_mm"],
        f"{name}: mean NIS": trial["mean_nis"],
        f"{name}: sightings not believed": trial["missed_sightings"],
    }
    if trial.get("commands"):
        told = summarise_steering(trial)
        values[f"{name}: turns asked for"] = told.turns
        values[f"{name}: paths found anew"] = told.replans
        values[f"{name}: stop"] = told.stop
    return values


def compare(old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
    """Return the first command of each insertion that the new settings would have told otherwise."""
    told = compare_steering(old, new)
    lines = [_command_line(what_if) for what_if in told]
    if not new["overrides"] and any(trial.get("as_recorded") is False for trial in new["insertions"]):
        lines.append("this labrig estimates otherwise than the one that made the run, with the same settings")
    return ResultComparison(tuple(lines), {"what_if": [asdict(what_if) for what_if in told]} if told else {})


def _command_line(told: WhatIf) -> str:
    name, first = f"insertion {told.trial + 1}", told.divergence
    if first is None:
        return f"{name}: every command is the same"
    where = "before it moves" if first.frame is None else f"at {first.depth_mm:.1f} mm, frame {first.frame}"
    return f"{name}: first command that differs {where}: {first.what} {first.old} before, {first.new} now"
