"""What a procedure writes to: the recorder, or a replay, which compares it with the record."""

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labrig.record.events import Event


class RecordSink(Protocol):
    """Takes pictures, states, events, truths and CAN frames as they happen; see `Recorder`."""

    @property
    def path(self) -> Path:
        """The folder of the run."""

    @property
    def run_name(self) -> str:
        """The name of the run."""

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Take a picture and return its number."""

    def state(self, t_s: float, **fields: object) -> None:
        """Take a reading of the axes at rig time `t_s` [s]."""

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Take an event of rig time `t_s` [s]."""

    def record_event(self, event: Event, t_s: float) -> None:
        """Take an event of rig time `t_s` [s]."""

    def truth(self, **fields: object) -> None:
        """Take what a simulated world drew."""

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Take frames of the CAN bus."""

    def close(self, exit_status: str, reason: str, ended: datetime) -> None:
        """End the run."""
