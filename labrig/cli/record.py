"""`labrig report`, `view` and `import`: show a run, or make a run from pictures."""

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

from labrig.cli.damage import report_damage
from labrig.cli.options import (
    DEFAULT_NEEDLE_DIAMETER_MM,
    IntrinsicsOption,
    NeedleDiameterOption,
    OptionalInsertion,
    OriginOption,
    PlaneOption,
    PxPerMmOption,
    RunArgument,
    RunsArgument,
    RunsDirOption,
    SheathDiameterOption,
    find_runs_dir,
)
from labrig.cli.output import AsJson, print_json, print_line, say
from labrig.cli.several_runs import add_damage, do_for_each_run
from labrig.errors import RecordError

_MOST_NAMED = 3
"""Imported runs that the next command names."""


def report(
    run_paths: RunsArgument,
    result: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Number of the result to show. Default: the newest."),
    ] = None,
    as_json: AsJson = False,
) -> int:
    """Write RUN/report.html of each run; the page of a run without a result states that there is none."""
    from labrig.library import door

    def report_run(path: Path) -> dict[str, object]:
        loaded = door.open_run(path)
        page = door.write_report(loaded, result=result)
        if not as_json:
            print_line(str(page))
        return add_damage({"report": str(page), "reason": None}, loaded.damage)

    return do_for_each_run(run_paths, report_run, as_json, key="report")


def view(
    run_path: RunArgument,
    as_json: AsJson = False,
) -> int:
    """Make RUN/view.rrd, which can be deleted and made again, and open it; with --json only make it."""
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library import door
    from labrig.report.viewer import open_view

    run = door.open_run(run_path)
    path = door.view(run, attendant=TerminalAttendant())
    damage = report_damage(run.damage)
    if as_json:
        print_json({"run": str(run_path), "view": str(path), "ok": damage is None, "reason": damage})
    else:
        print_line(str(path))
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
    runs_dir: RunsDirOption = None,
    as_json: AsJson = False,
) -> int:
    """Copy the pictures into runs, one for each folder; reanalyze, report and view take them like any other run."""
    from labrig.cli.import_pictures import ImportOrder, find_picture_folders, import_folder

    order = ImportOrder(
        px_per_mm=px_per_mm,
        origin_px=origin_px,
        insertion=insertion,
        intrinsics=intrinsics,
        plane=plane,
        needle_diameter_mm=needle_diameter_mm,
        sheath_diameter_mm=sheath_diameter_mm,
        runs_dir=find_runs_dir(runs_dir),
        command_line=tuple(sys.argv),
    )
    rows = []
    for source in find_picture_folders(folder):
        imported = import_folder(source, order)
        rows.append({"folder": str(source), **imported})
        if not as_json:
            print_line(f"{imported['run']}" + (f"  ({imported['reason']})" if imported["reason"] else ""))
    if as_json:
        print_json(rows)
    else:
        _say_next([str(row["run"]) for row in rows])
    return 0 if all(row["ok"] for row in rows) else 1


def _say_next(runs: Sequence[str]) -> None:
    """Say what to do with imported runs; of many, the first is an example."""
    place = " ".join(shlex.quote(run) for run in runs[:_MOST_NAMED]) + (" ..." if runs[_MOST_NAMED:] else "")
    say(f"measure the pictures: labrig reanalyze {place}\nthen write the page: labrig report {place}")
