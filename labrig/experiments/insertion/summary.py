"""What a terminal shows of insertions to a target, and of what another setting would have told them."""

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from labrig.analysis.summary import ResultComparison, Summary, TextTable
from labrig.experiments.insertion.what_if import WhatIf, compare_steering, summarise_steering
from labrig.text import number

_HEADS = ("insertion", "outcome", "error mm", "true error mm", "true clearance mm", "length mm", "replans")


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
    told = summarise_steering(trial)
    if told is not None:
        values[f"{name}: turns asked for"] = told.turns
        values[f"{name}: paths found anew"] = told.replans
        values[f"{name}: stop"] = told.stop
    return values


def compare(old: Mapping[str, Any], new: Mapping[str, Any]) -> ResultComparison:
    """Return the first command of each insertion that the new settings would have told otherwise."""
    told = compare_steering(old, new)
    lines = [_command_line(each) for each in told]
    if not new["overrides"] and any(trial.get("as_recorded") is False for trial in new["insertions"]):
        lines.append("this labrig estimates otherwise than the one that made the run, with the same settings")
    return ResultComparison(tuple(lines), {"what_if": [asdict(each) for each in told]} if told else {})


def _command_line(told: WhatIf) -> str:
    name, first = f"insertion {told.trial + 1}", told.divergence
    if first is None:
        return f"{name}: every command is the same"
    where = "before it moves" if first.frame is None else f"at {first.depth_mm:.1f} mm, frame {first.frame}"
    return f"{name}: first command that differs {where}: {first.what} {first.old} before, {first.new} now"
