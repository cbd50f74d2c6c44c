"""`RUN/view.rrd`: the record on the time line of the rerun viewer. Made from the record, and thrown away at will.

rerun files are read by neighbouring versions of the viewer alone, so this is a view and never a record. Two
time lines: `rig_time` [s] and `frame`. The pictures are JPEG here; the measured ones carry the shaft, those of an
insertion obstacles, target, plan and path, with the estimate's curves beside them.
"""

import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pandas as pd
import rerun as rr
import rerun.blueprint as rrb

from labrig.analysis.result import CentreLines
from labrig.errors import MachineError
from labrig.record.durable import require_free_bytes, write_atomically
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


def write_view(run: Run, lines: CentreLines, view: View) -> Path:
    """Write `RUN/view.rrd`, replacing an older one, and return its path.

    Parameters
    ----------
    run : Run
        Of any experiment and any exit status.
    lines : CentreLines
        The shafts that were found.
    view : View
        What its experiment adds.

    Raises
    ------
    RecordError
        When a picture of the record is missing or damaged.
    DiskError
        When the file cannot be written, or the disk has no room for it.
    """
    path = run.path / VIEW_FILE
    unfinished = path.with_name(f".{VIEW_FILE}.tmp")
    # rerun says nothing of a full disk; JPEG needs less than the lossless pictures do.
    files = {run.path / picture.file for picture in run.pictures}
    require_free_bytes(run.path, sum(file.stat().st_size for file in files if file.is_file()))
    write_atomically(unfinished, b"")
    try:
        _fill(unfinished, run, lines, view)
        unfinished.replace(path)
    finally:
        unfinished.unlink(missing_ok=True)
    return path


def _fill(file: Path, run: Run, lines: CentreLines, view: View) -> None:
    stream = rr.RecordingStream("labrig", recording_id=run.path.name)
    stream.save(file, default_blueprint=_blueprint(view))
    try:
        _send_axes(stream, run.states)
        _send_events(stream, run)
        _send_pictures(stream, run, lines)
        view.send(stream, _TIME)
    finally:
        stream.disconnect()


def open_view(path: Path) -> None:
    """Open a view in the viewer, in a process of its own that listens on this computer alone.

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


def _blueprint(view: View) -> rrb.Blueprint:
    """Return what stands where."""
    curves = tuple(rrb.TimeSeriesView(origin=origin, name=name) for origin, name in view.curves)
    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Spatial2DView(origin="/camera", name="Camera"),
            rrb.Vertical(
                rrb.TimeSeriesView(origin="/axes", name="Axes (mm, rad)"),
                *curves,
                rrb.TextLogView(origin="/events", name="Events"),
                row_shares=[3, *(3 for _ in curves), 2],
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline=_TIME, state="collapsed"),
    )


def _send_axes(stream: rr.RecordingStream, states: pd.DataFrame) -> None:
    """Send what the axes read, a column an axis."""
    for name in _AXES:
        if name not in states or states.empty:
            continue
        times = rr.TimeColumn(_TIME, duration=states["t_s"].to_numpy(dtype=np.float64))
        values = rr.Scalars.columns(scalars=states[name].to_numpy(dtype=np.float64))
        stream.send_columns(f"/axes/{name}", [times], values)


def _send_events(stream: rr.RecordingStream, run: Run) -> None:
    for event in run.lines("events"):
        stream.set_time(_TIME, duration=event["t_s"])
        stream.log("/events", rr.TextLog(_event_text(add_axis_units(event))))


def _event_text(event: Mapping[str, object]) -> str:
    said = [
        f"{key}={value}" for key, value in event.items() if key not in {"kind", "t_s"} and value is not None
    ]
    return f"{event['kind']}: {', '.join(said)}" if said else str(event["kind"])


def _send_pictures(stream: rr.RecordingStream, run: Run, lines: CentreLines) -> None:
    for line in run.frame_lines:
        frame = line.frame
        stream.set_time(_TIME, duration=line.t_s)
        stream.set_time(_FRAME, sequence=frame)
        picture = rr.EncodedImage(contents=jpeg(run.read_frame(frame), _PICTURE), media_type="image/jpeg")
        stream.log("/camera", picture)
        if lines.px:
            shaft = [lines.px[frame]] if frame in lines.px else []
            # An empty one ends the line of the picture before.
            stream.log(
                "/camera/shaft", rr.LineStrips2D(shaft, colors=[_SHAFT_COLOUR] * len(shaft), radii=1.0)
            )
