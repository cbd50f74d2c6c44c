"""Makes `RUN/view.rrd` of a run as it is."""

from collections.abc import Callable
from pathlib import Path

from labrig.analysis.result import find_newest_result_folder, load_centre_lines
from labrig.devices.drives.states import describe_statusword
from labrig.errors import InputError
from labrig.experiments.registry import make_run_view
from labrig.record.reader import Run
from labrig.report.rerun_view import write_view
from labrig.report.view import NO_VIEW, View


def make_view_file(run: Run, say: Callable[[str], None]) -> Path:
    """Write the view of a run, and return its path; `say` takes what it lacks.

    Raises
    ------
    RecordError
        When a picture or a result is missing or damaged.
    DiskError
        When it cannot be written.
    """
    folder = find_newest_result_folder(run)
    lines = {} if folder is None else load_centre_lines(folder)
    return write_view(run, lines, _make_view(run, say), describe_statusword)


def _make_view(run: Run, say: Callable[[str], None]) -> View:
    try:
        return make_run_view(run)
    except InputError as error:
        say(f"note: {error.message}; the record is shown without what it adds")
        return NO_VIEW
