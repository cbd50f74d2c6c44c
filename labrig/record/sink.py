"""What a procedure tells of itself: the recorder takes it, and so does a replay, which compares it."""

from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from labrig.record.events import Event


class RecordSink(Protocol):
    """Takes frames, states, events, truths and CAN frames as they happen; see `Recorder`."""

    @property
    def path(self) -> Path:
        """The folder of the run."""
        ...

    @property
    def run_name(self) -> str:
        """The name of the run."""
        ...

    def frame(self, image: NDArray[np.uint8], t_s: float, **fields: object) -> int:
        """Take a picture and return its number."""
        ...

    def state(self, t_s: float, **fields: object) -> None:
        """Take what the axes read at rig time `t_s` [s]."""
        ...

    def event(self, kind: str, t_s: float, **fields: object) -> None:
        """Take what happened at rig time `t_s` [s]."""
        ...

    def record_event(self, event: Event, t_s: float) -> None:
        """Take an event that happened at rig time `t_s` [s]."""
        ...

    def truth(self, **fields: object) -> None:
        """Take what a simulated world drew."""
        ...

    def can_frames(self, frames: Iterable[tuple[float, int, bytes, str]]) -> None:
        """Take what passed on the bus."""
        ...

    def close(self, exit_status: str, reason: str, ended: datetime) -> None:
        """End the run."""
        ...
