"""`RUN/view.rrd`: the record on the time line of the rerun viewer; it can be deleted and made again.

Only neighbouring versions of the viewer read a rerun file, so this is a view and never a record. It has two time lines,
`rig_time` [s] and `frame`. The pictures are JPEG; measured ones show the shaft, those of an insertion also obstacles,
target, plan and path, with the curves of the estimate beside them.
"""

import shutil
import subprocess
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr
import rerun.blueprint as rrb

from labrig.analysis.result import CentreLines
from labrig.durable import disk_errors, require_free_bytes, sync_file, temporary_file
from labrig.errors import MachineError
from labrig.posix import sync_directory
from labrig.record.reader import Run
from labrig.record.tables import add_axis_units
from labrig.report.pictures import JpegSize, jpeg
from labrig.report.view import View

VIEW_FILE = "view.rrd"
_TIME = "rig_time"
_FRAME = "frame"
_PICTURE = JpegSize(1920, 80)
_SHAFT_COLOUR = (86, 180, 233)
_AXES = ("insertion_mm", "rotation_rad", "linear_mm")
_CURRENTS = ("insertion_current_ma", "rotation_current_ma", "linear_current_ma")


def write_view(run: Run, lines: CentreLines, view: View) -> Path:
    """Write `RUN/view.rrd`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        A run of any experiment and exit status.
    lines : CentreLines
        The measured shafts.
    view : View
        The additions of its experiment.

    Raises
    ------
    RecordError
        When a picture of the record is missing or damaged.
    DiskError
        When the file cannot be written, or does not fit on the disk.
    """
    path = run.path / VIEW_FILE
    # rerun does not report a full disk. JPEG needs less space than the lossless pictures.
    files = {run.path / picture.file for picture in run.pictures}
    require_free_bytes(run.path, sum(file.stat().st_size for file in files if file.is_file()))
    with disk_errors(path), temporary_file(path) as unfinished:
        # Made here, because rerun does not report a folder that it cannot write either.
        unfinished.touch(exist_ok=False)
        _fill(unfinished, run, lines, view)
        sync_file(unfinished)
        unfinished.replace(path)
        sync_directory(path.parent)
    return path


def _fill(file: Path, run: Run, lines: CentreLines, view: View) -> None:
    stream = rr.RecordingStream("labrig", recording_id=run.path.name)
    stream.save(file, default_blueprint=_make_blueprint(view))
    try:
        _send_columns(stream, run.states, "/axes", _AXES)
        _send_columns(stream, run.states, "/currents", _CURRENTS)
        _send_events(stream, run)
        _send_pictures(stream, run, lines)
        view.send(stream, _TIME)
    finally:
        stream.disconnect()


def open_view(path: Path) -> None:
    """Open a view in the viewer, a separate process that listens only on this computer.

    Raises
    ------
    MachineError
        When the viewer is not installed.
    """
    viewer = shutil.which("rerun", path=str(Path(sys.executable).parent)) or shutil.which("rerun")
    if viewer is None:
        raise MachineError(
            "the rerun viewer is not installed", "install rerun-sdk, or copy view.rrd to where it is"
        )
    command = [viewer, "--new", "--bind", "127.0.0.1", str(path)]
    subprocess.Popen(  # noqa: S603 - the viewer that was found, with a path that labrig made
        command,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )


def _make_blueprint(view: View) -> rrb.Blueprint:
    """Return the layout of the viewer."""
    curves = tuple(rrb.TimeSeriesView(origin=origin, name=name) for origin, name in view.curves)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="/camera", name="Camera"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="/axes", name="Axes (mm, rad)"),
                rrb.TimeSeriesView(origin="/currents", name="Motor currents (mA)"),
                *curves,
                rrb.TextLogView(origin="/events", name="Events"),
                row_shares=[3, 2, *(3 for _ in curves), 2],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=_TIME, state="collapsed"),
    )


def _send_columns(stream: rr.RecordingStream, states: pd.DataFrame, place: str, names: Sequence[str]) -> None:
    """Send readings of the axes, a column for each; records of before have no currents."""
    for name in names:
        if name not in states or states[name].isna().all():
            continue
        times = rr.TimeColumn(_TIME, duration=states["t_s"].to_numpy(dtype=np.float64))
        values = rr.Scalars.columns(scalars=states[name].to_numpy(dtype=np.float64))
        stream.send_columns(f"{place}/{name}", [times], values)


def _send_events(stream: rr.RecordingStream, run: Run) -> None:
    for event in run.lines("events"):
        stream.set_time(_TIME, duration=event["t_s"])
        stream.log("/events", rr.TextLog(_format_event(add_axis_units(event))))


def _format_event(event: Mapping[str, object]) -> str:
    fields = [
        f"{key}={value}" for key, value in event.items() if key not in {"kind", "t_s"} and value is not None
    ]
    return f"{event['kind']}: {', '.join(fields)}" if fields else str(event["kind"])


def _send_pictures(stream: rr.RecordingStream, run: Run, lines: CentreLines) -> None:
    for line in run.frame_lines:
        frame = line.frame
        stream.set_time(_TIME, duration=line.t_s)
        stream.set_time(_FRAME, sequence=frame)
        picture = rr.EncodedImage(contents=jpeg(run.read_frame(frame), _PICTURE), media_type="image/jpeg")
        stream.log("/camera", picture)
        if lines.px:
            shaft = [lines.px[frame]] if frame in lines.px else []
            # An empty strip ends the line of the previous picture.
            stream.log(
                "/camera/shaft", rr.LineStrips2D(shaft, colors=[_SHAFT_COLOUR] * len(shaft), radii=1.0)
            )
