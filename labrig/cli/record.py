"""`labrig reanalyze`, `report`, `view` and `import`: everything that reads a run, or makes one of pictures."""

import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import typer

from labrig.cli.damage import tell_damage
from labrig.cli.options import (
    DEFAULT_NEEDLE_DIAMETER_MM,
    DEFAULT_RUNS_DIR,
    IntrinsicsOption,
    MaskOption,
    NeedleDiameterOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    RunsDirOption,
    SheathDiameterOption,
)
from labrig.cli.output import AsJson, failure_lines, print_json, print_table, say
from labrig.errors import LabrigError, Problem, RecordError

RunsArgument = Annotated[list[Path], typer.Argument(metavar="RUN...", help="Folders of runs.")]


def register(app: typer.Typer) -> None:
    """Add the commands to `labrig`."""
    app.command("report", help="Write the report page of runs again, from their newest result.")(report)
    app.command("reanalyze", help="Measure the pictures of runs again, into a new numbered result.")(
        reanalyze
    )
    app.command("view", help="Make view.rrd from the record and open it in the rerun viewer.")(view)
    app.command("import", help="Turn folders of loose pictures into runs.")(import_)


def reanalyze(
    run_paths: RunsArgument,
    settings: Annotated[
        list[str] | None,
        typer.Option(
            "--set",
            metavar="KEY=VALUE",
            help="Override analysis.* or, of an insertion, estimator.*",
            show_default=False,
        ),
    ] = None,
    mask: MaskOption = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/analysis/NNN and print the new numbers beside the old ones; the record itself is never rewritten."""
    from labrig.cli.analyzing import analyze, analyze_several

    overrides, command_line = tuple(settings or ()), tuple(sys.argv)
    at_once = len(set(run_paths)) > 1
    several = analyze_several(run_paths, command_line, overrides, mask) if at_once else {}

    def one(path: Path) -> dict[str, object]:
        outcome = several.get(path)
        if isinstance(outcome, LabrigError):
            raise outcome
        old = _newest(path) if outcome is None else _parent(path, outcome.content.parent)
        new = analyze(path, command_line, overrides, mask) if outcome is None else outcome
        if not as_json:
            _print_old_and_new(path, old, new.document)
        row: dict[str, object] = {"analysis": str(new.path), "reason": _nothing_found(new.document)}
        row |= _divergence(old, new.document, as_json) | _what_if(path, new.path, overrides, as_json)
        return _undamaged(row, new.document["damage"])

    return _each(run_paths, one, as_json, key="analysis")


def _divergence(old: Mapping[str, Any] | None, new: Mapping[str, Any], as_json: bool) -> dict[str, object]:
    """Say where a result parts from the one before it, and return that for JSON."""
    from dataclasses import asdict

    from labrig.analysis import first_divergence

    if old is None:
        return {"parent": None, "first_divergence": None}
    found = first_divergence(old, new)
    if not as_json:
        typer.echo("the numbers are identical" if found is None else f"first divergence: {_told(found)}")
    return {"parent": new["parent"], "first_divergence": None if found is None else asdict(found)}


def _what_if(path: Path, result: Path, overrides: tuple[str, ...], as_json: bool) -> dict[str, object]:
    """Steer the insertions of a run again over what was seen in them; nothing for runs of another kind."""
    from dataclasses import asdict

    from labrig.analysis import steer_again
    from labrig.protocol import InsertionProtocol, load_protocol
    from labrig.record import encode_document, open_run, write_atomically

    run = open_run(path)
    if not isinstance(run.protocol, InsertionProtocol):
        return {}
    other = load_protocol(path / "protocol.yaml", overrides)
    assert isinstance(other, InsertionProtocol)
    found = steer_again(run, other)
    rows = [asdict(one) for one in found]
    write_atomically(
        result / "what_if.json", encode_document({"overrides": list(overrides), "insertions": rows})
    )
    for one in () if as_json else found:
        _print_what_if(one)
    return {"what_if": rows}


def _print_what_if(one: Any) -> None:
    old, new = one.old, one.new
    rows: list[list[object]] = [
        ["turns of the bevel", old.turns, new.turns],
        ["paths found anew", old.replans, new.replans],
        ["ends with", old.stop, new.stop],
        ["tip estimated at y, mm", old.tip_mm[1], new.tip_mm[1]],
        ["tip estimated at z, mm", old.tip_mm[2], new.tip_mm[2]],
    ]
    print_table((f"insertion {one.trial} steered again", "as it was", "what if"), rows)
    if not one.as_recorded:
        typer.echo(
            "this labrig estimates otherwise than the one that made the run, with the run's own settings too"
        )
    first = one.divergence
    typer.echo(
        "every command is the same"
        if first is None
        else f"first command that differs: at {first.depth_mm:.1f} mm, frame {first.frame}, "
        f"{first.what}: {first.old} as it was, {first.new} what if"
    )


def _told(found: Any) -> str:
    where = "" if found.frame is None else f"frame {found.frame}, "
    return f"{where}{found.key}: {found.old} before, {found.new} now"


def _newest(path: Path) -> Mapping[str, Any] | None:
    """Return the newest result so far; a damaged one is named and does not keep a new one from being made."""
    from labrig.analysis import load_result
    from labrig.record import open_run

    run = open_run(path)
    try:
        old = load_result(run)
    except RecordError as error:
        say(f"note: {error.message}; a new result is made")
        return None
    return None if old is None else old.document


def _parent(path: Path, number: int | None) -> Mapping[str, Any] | None:
    """Return the result that a new one comes after; None where there is none, or it is damaged."""
    from labrig.analysis import load_result
    from labrig.record import open_run

    if number is None:
        return None
    try:
        old = load_result(open_run(path), number)
    except RecordError as error:
        say(f"note: {error.message}")
        return None
    return None if old is None else old.document


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


def _print_old_and_new(path: Path, old: object, new: object) -> None:
    """Print the specimens' mean radii and the counts of pictures, or the answers of a design, old beside new."""
    typer.echo(str(path))
    rows = [
        [name, before, after]
        for (name, before), (_, after) in zip(_summary(old, new), _summary(new, new), strict=True)
    ]
    print_table(("", "old", "new"), rows)


def _summary(document: object, names_of: object) -> list[tuple[str, object]]:
    names = _values(names_of)
    values = _values(document)
    return [(name, values.get(name)) for name in names]


def _values(document: object) -> dict[str, object]:
    if not isinstance(document, dict):
        return {}
    if document.get("kind") == "design":
        return {
            "inclination by equation (3), degrees": document["beta_cut_deg"],
            "inclination on our contour, degrees": document["search"]["beta_cut_deg"],
            "RMSE of our plane, degrees": document["search"]["fit"]["rmse_deg"],
        }
    if document.get("kind") == "insertion":
        return _insertion_values(document)
    measured = document.get("measurements", ())
    values: dict[str, object] = {
        f"{specimen['name']}: mean radius mm": specimen["mean_radius_mm"]
        for specimen in document.get("specimens", ())
    }
    values["pictures"] = len(measured)
    values["shaft and tip found"] = sum(bool(one["found"]) for one in measured)
    values["radius accepted"] = sum(bool(one["accepted"]) for one in measured)
    return values


def _insertion_values(document: Mapping[str, Any]) -> dict[str, object]:
    values: dict[str, object] = {"target reached": f"{document['arrived']} of {document['made']}"}
    for one in document["insertions"]:
        name = f"insertion {one['trial'] + 1}"
        values[f"{name}: error mm"] = one["target_error_mm"]
        values[f"{name}: error by the estimate mm"] = one["template_error_mm"]
        values[f"{name}: mean NIS"] = one["mean_nis"]
        values[f"{name}: sightings not believed"] = one["missed_sightings"]
    return values


def report(run_paths: RunsArgument, as_json: AsJson = False) -> int:
    """Write RUN/report.html of each run; a run without a result gets a page that says so."""
    from labrig.analysis import load_result
    from labrig.devices import SystemClock
    from labrig.record import open_run
    from labrig.report import write_report

    def one(path: Path) -> dict[str, object]:
        loaded = open_run(path)
        page = write_report(loaded, load_result(loaded), SystemClock().utc())
        if not as_json:
            typer.echo(str(page))
        return _undamaged({"report": str(page), "reason": None}, loaded.damage)

    return _each(run_paths, one, as_json, key="report")


def _undamaged(row: dict[str, object], damage: Sequence[Problem | str]) -> dict[str, object]:
    """Return the row of a run, not ok where its record is damaged; what could be done has been done all the same."""
    told = tell_damage(damage)
    return row if told is None else {**row, "ok": False, "reason": told}


def _each(paths: list[Path], work: Callable[[Path], dict[str, object]], as_json: bool, key: str) -> int:
    """Do the work for each run and go on after a refusal; exit with the first failure's code."""
    rows: list[dict[str, object]] = []
    exit_code = 0
    for path in paths:
        try:
            rows.append({"run": str(path), "ok": True, **work(path)})
            if rows[-1]["ok"] is False:
                exit_code = exit_code or RecordError.exit_code
        except LabrigError as error:
            exit_code = exit_code or error.exit_code
            rows.append({"run": str(path), key: None, "ok": False, "reason": error.message})
            for line in failure_lines(error):
                say(line)
    if as_json:
        print_json(rows)
    return exit_code


def view(
    run_path: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.")],
    open_viewer: Annotated[
        bool, typer.Option("--open/--no-open", help="Open the viewer, or only make the file.")
    ] = True,
    as_json: AsJson = False,
) -> int:
    """Make RUN/view.rrd, which can be thrown away and made again, and open it."""
    from labrig.analysis import load_result
    from labrig.record import open_run
    from labrig.report.rerun_view import open_view, write_view

    run = open_run(run_path)
    path = write_view(run, load_result(run))
    damage = tell_damage(run.damage)
    if as_json:
        print_json({"run": str(run_path), "view": str(path), "ok": damage is None, "reason": damage})
    else:
        typer.echo(str(path))
    if open_viewer:
        open_view(path)
    return RecordError.exit_code if damage else 0


def import_(
    folder: Annotated[
        Path, typer.Argument(metavar="FOLDER", help="Folder of pictures, or of folders of pictures.")
    ],
    px_per_mm: PxPerMmOption = None,
    origin_px: OriginOption = None,
    insertion: OptionalInsertion = None,
    intrinsics: IntrinsicsOption = None,
    plane: PlaneOption = None,
    needle_diameter_mm: NeedleDiameterOption = DEFAULT_NEEDLE_DIAMETER_MM,
    sheath_diameter_mm: SheathDiameterOption = None,
    title: Annotated[
        str | None, typer.Option(help="Title of the runs. Default: the folder's name.", show_default=False)
    ] = None,
    runs_dir: RunsDirOption = DEFAULT_RUNS_DIR,
    as_json: AsJson = False,
) -> int:
    """Copy the pictures into runs, one a folder, which reanalyze, report and view take like any other run."""
    from labrig.cli.importing import ImportOrder, import_folder, picture_folders

    order = ImportOrder(
        px_per_mm=px_per_mm,
        origin_px=origin_px,
        insertion=insertion,
        intrinsics=intrinsics,
        plane=plane,
        needle_diameter_mm=needle_diameter_mm,
        sheath_diameter_mm=sheath_diameter_mm,
        title=title,
        runs_dir=runs_dir,
        command_line=tuple(sys.argv),
    )
    rows = []
    for source in picture_folders(folder):
        imported = import_folder(source, order)
        rows.append({"folder": str(source), **imported})
        if not as_json:
            typer.echo(f"{imported['run']}" + (f"  ({imported['reason']})" if imported["reason"] else ""))
    if as_json:
        print_json(rows)
    return 0 if all(row["ok"] for row in rows) else 1
