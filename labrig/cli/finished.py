"""How a run ended, and how that is told."""

import math
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from labrig.cli.design_study import print_design
from labrig.cli.output import (
    failure_document,
    failure_lines,
    interval,
    number,
    print_json,
    print_line,
    print_table,
    say,
)
from labrig.errors import LabrigError


@dataclass(frozen=True)
class Finished:
    """How it ended; `result` and `report` are None where it was not measured, or the answer is no.

    `needle` says where the needle was left, and is empty where it is out; `can_resume` is for sweeps.
    """

    run: Path
    exit_status: str
    reason: str
    report: Path | None
    result: Mapping[str, object] | None
    error: LabrigError | None
    needle: str
    can_resume: bool = False


def tell(finished: Finished, as_json: bool) -> int:
    """Print how a run ended, and return the exit code."""
    document: dict[str, object] = {
        "run": str(finished.run),
        "exit_status": finished.exit_status,
        "reason": finished.reason or None,
        "report": None if finished.report is None else str(finished.report),
        "result": finished.result,
    }
    place = shlex.quote(str(finished.run))
    if finished.error is not None:
        document["error"] = failure_document(finished.error)
        for line in failure_lines(finished.error):
            say(line)
        if finished.needle:
            say(f"note: {finished.needle}")
        if finished.result is None:
            say(f"the record is kept: {finished.run}\nmeasure what it holds: labrig reanalyze {place}")
        if finished.result is None and finished.exit_status != "success" and finished.can_resume:
            say(f"go on with it: labrig resume {place}")
    if as_json:
        print_json(document)
    elif finished.result is not None:
        print_result(finished.result)
        print_line(f"record  {finished.run}\nreport  {finished.report}")
    if finished.error is not None:
        return finished.error.exit_code
    said = {} if finished.result is None else finished.result
    return 1 if said.get("accepted") is False or said.get("reached") is False else 0


def print_result(result: Mapping[str, Any]) -> None:
    """Print the table of the paper for a sweep; the verdict for a calibration; what to cut for a design."""
    if (printed := _PRINTED.get(str(result.get("kind")))) is not None:
        printed(result)
        return
    specimens: Sequence[Mapping[str, Any]] = result.get("specimens", ())
    if specimens:
        rows = [
            [
                specimen["name"],
                f"{specimen['gelatin_percent']:g}",
                specimen["n"],
                specimen["refused"],
                number(specimen["mean_radius_mm"]),
                number(specimen["sd_radius_mm"]),
                interval(specimen["ci95_mm"]),
            ]
            for specimen in specimens
        ]
        print_table(("specimen", "gelatin %", "n", "refused", "radius mm", "SD mm", "95 % interval mm"), rows)
        print_line(f"mean of the means  {number(result['mean_radius_mm'])} mm")
    elif "accepted" in result:
        print_line("calibration accepted" if result["accepted"] else "calibration refused")
        for reason in result.get("reasons", ()):
            print_line(f"  {reason}")


def _print_insertions(result: Mapping[str, Any]) -> None:
    rows = [
        [
            one["trial"] + 1,
            one["outcome"],
            number(one["target_error_mm"]),
            number(one["true_target_error_mm"]),
            number(one["true_min_clearance_mm"]),
            number(one["length_mm"], 1),
            one["replans"],
        ]
        for one in result["insertions"]
    ]
    heads = ("insertion", "outcome", "error mm", "true error mm", "true clearance mm", "length mm", "replans")
    print_table(heads, rows)
    print_line(f"{result['arrived']} of {result['made']} reached the target")


def _print_roll_zero(result: Mapping[str, Any]) -> None:
    fit = result["fit"]
    if fit is None or not result["accepted"]:
        print_line("roll zero refused")
        for reason in result["reasons"]:
            print_line(f"  {reason}")
        return
    zero, sd = (math.degrees(fit[key]) for key in ("zero_rad", "sd_rad"))
    print_line(
        f"needle {result['needle_id']} bends towards -y at {number(zero)} degrees, SD {number(sd)} degrees"
    )


_PRINTED: Mapping[str, Callable[[Mapping[str, Any]], None]] = {
    "design": print_design,
    "insertion": _print_insertions,
    "roll-zero": _print_roll_zero,
}
