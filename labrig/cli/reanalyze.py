"""`labrig reanalyze`: a run measured again, and the new numbers beside the old ones."""

import sys
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.each_run import each_run, undamaged
from labrig.cli.options import LocalRunsArgument, MaskOption
from labrig.cli.output import AsJson, print_line, print_table, say
from labrig.errors import LabrigError, RecordError

_LENS_PX = ("fx", "fy", "cx", "cy", "rms_px", "holdout_rms_px")
_PLANE = ("mm_per_px", "rms_mm", "holdout_rms_mm")


def reanalyze(
    run_paths: LocalRunsArgument,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override analysis.* or, of an insertion, estimator.*, planner.*, policy.*",
            show_default=False,
        ),
    ] = None,
    mask: MaskOption = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/analysis/NNN and print the new numbers beside the old ones; the record itself is never rewritten."""
    from labrig.cli.analyze import analyze, analyze_several

    overrides, command_line = tuple(settings or ()), tuple(sys.argv)
    at_once = len(set(run_paths)) > 1
    several = analyze_several(run_paths, command_line, overrides, mask) if at_once else {}

    def one(path: Path) -> dict[str, object]:
        outcome = several.get(path)
        if isinstance(outcome, LabrigError):
            raise outcome
        new = analyze(path, command_line, overrides, mask) if outcome is None else outcome
        old = _parent(path, new.content.parent)
        if not as_json:
            _print_old_and_new(path, old, new)
        row: dict[str, object] = {"analysis": str(new.path), "reason": _nothing_found(new.document)}
        return undamaged(row | _compared(old, new.document, as_json), new.document["damage"])

    return each_run(run_paths, one, as_json, key="analysis")


def _parent(path: Path, number: int | None) -> Any:
    """Return the result that a new one is compared with, None where there is none; name newer ones that are damaged."""
    from labrig.analysis.result import load_result, result_numbers
    from labrig.record.reader import open_run

    run = open_run(path)
    for newer in result_numbers(run):
        if number is None or newer > number:
            try:
                load_result(run, newer)
            except RecordError as error:
                say(f"note: {error.message}")
    return None if number is None else load_result(run, number)


def _compared(old: Any, new: Mapping[str, Any], as_json: bool) -> dict[str, object]:
    """Say where a result parts from its parent, and return that for JSON."""
    from labrig.analysis.divergence import first_divergence
    from labrig.analysis.what_if import compare_steering

    if old is None:
        return {"parent": None, "first_divergence": None}
    found, steered = first_divergence(old.document, new), compare_steering(old.document, new)
    if not as_json:
        print_line("the numbers are identical" if found is None else f"first divergence: {_told(found)}")
        for one in steered:
            _tell_command(one)
        if not new["overrides"] and any(one.get("as_recorded") is False for one in new.get("insertions", ())):
            print_line(
                "this labrig estimates otherwise than the one that made the run, with the same settings"
            )
    told = {"what_if": [asdict(one) for one in steered]} if steered else {}
    return {"parent": new["parent"], "first_divergence": None if found is None else asdict(found), **told}


def _told(found: Any) -> str:
    where = "" if found.frame is None else f"frame {found.frame}, "
    return f"{where}{found.key}: {found.old} before, {found.new} now"


def _tell_command(one: Any) -> None:
    name, first = f"insertion {one.trial + 1}", one.divergence
    if first is None:
        print_line(f"{name}: every command is the same")
        return
    where = "before it moves" if first.frame is None else f"at {first.depth_mm:.1f} mm, frame {first.frame}"
    print_line(
        f"{name}: first command that differs {where}: {first.what} {first.old} before, {first.new} now"
    )


def _nothing_found(document: Mapping[str, Any]) -> str | None:
    """Return a sentence where no picture shows a needle, as when a folder of other pictures was imported."""
    measured = document.get("measurements", ())
    if not measured or any(one["found"] for one in measured):
        return None
    reason = (
        f"shaft and tip were found in none of {len(measured)} pictures; the first: {measured[0]['reason']}"
    )
    say(f"note: {reason}")
    return reason


def _print_old_and_new(path: Path, old: Any, new: Any) -> None:
    """Print what counts in the results of an experiment, old beside new, under their numbers and settings."""
    print_line(str(path))
    for name, result in (("old", old), ("new", new)):
        if result is not None:
            settings = " ".join(result.content.overrides) or "the run's own settings"
            print_line(f"{name}: analysis/{result.path.name}, {settings}")
    before, now = {} if old is None else _values(old.document), _values(new.document)
    print_table(("", "old", "new"), [[name, before.get(name), value] for name, value in now.items()])


def _values(document: Mapping[str, Any]) -> dict[str, object]:
    match document["kind"]:
        case "design":
            return {
                "inclination by equation (3), degrees": document["beta_cut_deg"],
                "inclination on our contour, degrees": document["search"]["beta_cut_deg"],
                "RMSE of our plane, degrees": document["search"]["fit"]["rmse_deg"],
            }
        case "insertion":
            return _insertion_values(document)
        case "calibration":
            return _calibration_values(document)
        case "roll-zero":
            return {"accepted": document["accepted"], **(document["fit"] or {})}
    return _curvature_values(document)


def _curvature_values(document: Mapping[str, Any]) -> dict[str, object]:
    measured = document["measurements"]
    return {
        **{f"{one['name']}: mean radius mm": one["mean_radius_mm"] for one in document["specimens"]},
        "pictures": len(measured),
        "shaft and tip found": sum(bool(one["found"]) for one in measured),
        "radius accepted": sum(bool(one["accepted"]) for one in measured),
    }


def _calibration_values(document: Mapping[str, Any]) -> dict[str, object]:
    lens, plane = document["intrinsics"] or {}, document["plane"] or {}
    return {
        "accepted": document["accepted"],
        "views used": sum(bool(one["used"]) for one in lens.get("views", ())),
        **{f"lens: {name}": lens.get(name) for name in _LENS_PX},
        **{f"plane: {name}": plane.get(name) for name in _PLANE},
    }


def _insertion_values(document: Mapping[str, Any]) -> dict[str, object]:
    from labrig.analysis.what_if import steered

    values: dict[str, object] = {"target reached": f"{document['arrived']} of {document['made']}"}
    for one in document["insertions"]:
        name = f"insertion {one['trial'] + 1}"
        values[f"{name}: error mm"] = one["target_error_mm"]
        values[f"{name}: error by the estimate mm"] = one["template_error_mm"]
        values[f"{name}: mean NIS"] = one["mean_nis"]
        values[f"{name}: sightings not believed"] = one["missed_sightings"]
        told = steered(one)
        if told is not None:
            values[f"{name}: turns asked for"] = told.turns
            values[f"{name}: paths found anew"] = told.replans
            values[f"{name}: stop"] = told.stop
    return values
