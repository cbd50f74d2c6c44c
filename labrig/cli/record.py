"""`labrig report` and `view`: show a run."""

import os
from pathlib import Path

from labrig.cli.options import RunArgument, RunsArgument
from labrig.cli.output import SPEAKS_JSON, print_json, print_line, say
from labrig.cli.several_runs import Row, add_damage, do_for_each_run, report_damage
from labrig.errors import RecordError


def report(run_paths: RunsArgument) -> int:
    """Write RUN/report.html of each run; the page of a run without a result states that there is none."""
    from labrig.library import door

    def report_run(path: Path) -> Row:
        loaded = door.open_run(path)
        page = door.write_report(loaded)
        print_line(str(page))
        return add_damage({"report": str(page), "reason": None}, loaded.damage)

    return do_for_each_run(run_paths, report_run, key="report")


def view(run_path: RunArgument) -> int:
    """Make RUN/view.rrd, which can be deleted and made again, and open it; with --json only make it.

    Without a display open it elsewhere: rerun view.rrd.
    """
    from labrig.cli.attendant import TerminalAttendant
    from labrig.library import door
    from labrig.report.viewer import has_display, open_view

    run = door.open_run(run_path)
    path = door.view(run, attendant=TerminalAttendant())
    damage = report_damage(run.damage)
    print_json({"run": str(run_path), "view": str(path), "ok": damage is None, "reason": damage})
    print_line(str(path))
    if not SPEAKS_JSON.get():
        if has_display(os.environ):
            open_view(path)
        else:
            say(f"there is no display here: copy it to a computer with one, and open it by rerun {path.name}")
    return RecordError.exit_code if damage else 0
