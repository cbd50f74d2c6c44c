"""The record of a run on a rig: whatever waits for the disk is done aside, while the axes are supervised."""

from collections.abc import Callable, Iterable
from datetime import datetime
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from labrig.devices.rig import Rig
from labrig.record.events import Event
from labrig.record.sink import RecordSink
from labrig.runner.session import Progress, Session


def begin_session(rig: Rig, open_record: Callable[[], RecordSink], progress: Progress) -> Session:
    """Return the session of a run, whose record is opened aside.

    Parameters
    ----------
    rig : Rig
        The opened rig.
    open_record : callable
        Opens the record.
    progress : callable
        Receives the progress.

    Raises
    ------
    OutputExistsError, DiskError
        When it cannot be opened.
    InterruptedRunError, SafetyStopError, BusError, DriveError
    """
    return Session(rig, SupervisedRecord(rig.do_aside(open_record), rig), progress)


class SupervisedRecord:
    """Passes everything on to a recorder, and returns when it is recorded, as the recorder itself does.

    Parameters
    ----------
    recorder : RecordSink
        The record.
    rig : Rig
        Its axes are supervised; each call raises what `Rig.do_aside` raises.
    """

    def __init__(self, recorder: RecordSink, rig: Rig) -> None:
        self._recorder = recorder
        self._rig = rig

    @property
    def path(self) -> Path:
        """The folder of the run."""
        return self._recorder.path

    @property
    def run_name(self) -> str:
        """The name of the run."""
        return self._recorder.run_name

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Record a picture and return its number."""
        return self._rig.do_aside(partial(self._recorder.frame, image, t_s, **fields))

    def state(self, t_s: float, **fields: object) -> None:
        """Record a reading of the axes."""
        self._rig.do_aside(partial(self._recorder.state, t_s, **fields))

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Record an event."""
        self._rig.do_aside(partial(self._recorder.event, kind, t_s, **fields))

    def record_event(self, event: Event, t_s: float) -> None:
        """Record an event."""
        self._rig.do_aside(partial(self._recorder.record_event, event, t_s))

    def truth(self, **fields: object) -> None:
        """Record what a simulated world drew."""
        self._rig.do_aside(partial(self._recorder.truth, **fields))

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Record frames of the CAN bus."""
        self._rig.do_aside(partial(self._recorder.can_frames, frames))

    def close(self, exit_status: str, reason: str, ended: datetime, **manifest_updates: object) -> None:
        """End the run."""
        self._rig.do_aside(partial(self._recorder.close, exit_status, reason, ended, **manifest_updates))
