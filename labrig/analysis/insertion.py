"""How near to their targets the insertions of a run ended, measured on the final pictures."""

import math
from collections.abc import Sequence
from typing import Any

from labrig.analysis.mapping import load_mapping
from labrig.analysis.pictures import Progress, Unreadable, measure_pictures
from labrig.analysis.result import InsertionResult, InsertionTrial, Stamp
from labrig.protocol import InsertionProtocol
from labrig.record import Run
from labrig.vision import CurvatureMeasurement, CurvatureSettings


def analyze_insertion(
    run: Run, protocol: InsertionProtocol, stamp: Stamp, workers: int, progress: Progress | None
) -> InsertionResult:
    """Measure where each insertion ended, by the end of the needle's shaft and not by the template that steered it.

    Raises
    ------
    InputError
        When the run has no map from pixels to mm.
    RecordError
        When its lines are damaged.
    """
    trials = run.trials.to_dict("records")
    finals = run.frame_table[run.frame_table["role"] == "final"].to_dict("records")
    settings = CurvatureSettings(protocol.needle.diameter_mm, protocol.sheath.diameter_mm)
    files = [run.pictures[int(one["frame"])] for one in finals]
    measured = measure_pictures(files, load_mapping(run), settings, workers, progress)
    ends = {int(one["trial"]): each for one, each in zip(finals, measured, strict=True)}
    truths = {int(one["trial"]): one for one in run.truth.to_dict("records")}
    insertions = tuple(
        _trial(one, ends.get(int(one["trial"])), truths.get(int(one["trial"]))) for one in trials
    )
    return InsertionResult(
        **stamp.fields({}),
        made=len(insertions),
        arrived=sum(one.reached for one in insertions),
        reached=bool(insertions) and all(one.reached for one in insertions),
        target_error_mm=_worst([one.target_error_mm for one in insertions]),
        true_target_error_mm=_worst([one.true_target_error_mm for one in insertions]),
        true_min_clearance_mm=_least([one.true_min_clearance_mm for one in insertions]),
        replans=sum(one.replans for one in insertions),
        length_mm=_worst([one.length_mm for one in insertions]),
        insertions=insertions,
    )


def _trial(
    line: dict[Any, Any], end: CurvatureMeasurement | Unreadable | None, truth: dict[Any, Any] | None
) -> InsertionTrial:
    target_mm = tuple(float(one) for one in line["target_mm"])
    tip_mm = end.tip_mm if isinstance(end, CurvatureMeasurement) else None
    reason = "there is no final picture" if end is None else end.reason if tip_mm is None else None
    outcome = line.get("outcome")
    stopped = outcome if isinstance(outcome, str) else "stopped"
    return InsertionTrial(
        trial=int(line["trial"]),
        outcome=stopped,
        cause=str(line["cause"]) if isinstance(line.get("cause"), str) else "the run ended",
        reached=stopped == "reached",
        target_mm=target_mm,
        tip_mm=tip_mm,
        target_error_mm=None if tip_mm is None else math.dist(tip_mm, target_mm[1:]),
        unmeasured=reason,
        true_target_error_mm=None if truth is None else _number(truth["true_target_error_mm"]),
        true_min_clearance_mm=None if truth is None else _number(truth["true_min_clearance_mm"]),
        replans=int(_number(line.get("replans")) or 0),
        length_mm=_number(line.get("depth_mm")),
    )


def _number(value: object) -> float | None:
    """Return a number of a line as it was recorded; what the line did not say is None."""
    return float(value) if isinstance(value, int | float) and math.isfinite(value) else None


def _worst(values: Sequence[float | None]) -> float | None:
    """Return the largest value that is known."""
    return max((one for one in values if one is not None), default=None)


def _least(values: Sequence[float | None]) -> float | None:
    return min((one for one in values if one is not None), default=None)
