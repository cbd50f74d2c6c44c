"""The process that shows a run live: starts the viewer, follows the record, and says what a person must know.

`python -m labrig.cli.live_follower KIND [PROGRAM]` starts the viewer, which is the program, and reads the run's folder
from standard input. It writes one sentence a line on standard output, and closes that when the ended run is shown. A
window stays by itself; for `web` the process goes on until the one that started it ends.
"""

import os
import sys
import webbrowser
from pathlib import Path

from labrig.cli.bug_report import keep_traceback
from labrig.devices.clocks import SystemClock
from labrig.devices.drives.states import describe_statusword
from labrig.errors import LabrigError
from labrig.experiments.declared import find_experiment
from labrig.experiments.registry import follow_run
from labrig.posix import end_with_parent
from labrig.record.following import GrowingRun
from labrig.record.reader import open_run
from labrig.report.local_server import suggest_forwarding
from labrig.report.rerun_view import show_live
from labrig.report.viewer import RunningViewer, ViewerKind, find_viewer, has_display, start_viewer

_LESS_URGENT = 10
"""By how much it is nicer than a process that moves axes."""


def main() -> None:
    """Show the run, and end without waiting for what the viewer has not taken."""
    end_with_parent()
    os.nice(_LESS_URGENT)
    kind, *program = sys.argv[1:]
    try:
        _show("web" if kind == "web" else "window", program[0] if program else find_viewer())
    except LabrigError as error:
        _tell(f"nothing is shown live: {error.message}" + (f"; {error.hint}" if error.hint else ""))
    except Exception as error:  # noqa: BLE001 - a bug ends this process alone
        _tell("it has ended: " + "; ".join(keep_traceback(error)))
    # At its exit, too, rerun would wait for a viewer that takes nothing.
    os._exit(0)


def _show(wanted: ViewerKind, program: str) -> None:
    clock = SystemClock()
    kind = wanted if has_display(os.environ) else "web"
    viewer = start_viewer(kind, clock, program)
    if kind != wanted:
        _tell(
            "there is no display here: a browser shows the run while it lasts, and with --live web after it"
        )
    _tell_where(viewer)
    # What takes a second to load is loaded while the rig is opened: the first picture is not kept waiting.
    find_experiment("insertion").part("follow")
    path = sys.stdin.readline().rstrip("\n")
    if not path:
        return
    view = follow_run(open_run(Path(path)))
    show_live(GrowingRun(Path(path)), view, viewer, describe_statusword, clock=clock, tell=_tell)
    if wanted == "web":
        os.close(sys.stdout.fileno())
        viewer.process.wait()


def _tell_where(viewer: RunningViewer) -> None:
    """Say where the run can be seen, from another computer too."""
    if viewer.kind == "window":
        _tell("the run is shown in a window of its own")
        return
    _tell(f"open {viewer.page}\n{suggest_forwarding(viewer.port, viewer.web_port)}")
    if has_display(os.environ):
        webbrowser.open(viewer.page)


def _tell(text: str) -> None:
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


if __name__ == "__main__":
    main()
