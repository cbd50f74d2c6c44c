"""An append-only log beside the rig's state file: who moved an axis by hand, when, from where and to where.

Runs and withdrawals have records of their own. Homing and jogging write two lines each: one before anything
moves, to survive a power cut, and one when the axis stands still again. A simulated rig without a state file is
new in every run and keeps no log.
"""

import getpass
import platform
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager, suppress
from datetime import datetime
from functools import partial
from pathlib import Path

from labrig.devices.axis import Axis
from labrig.devices.worker import Do
from labrig.errors import DiskError, LabrigError, MachineError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.record.json_lines import LineFile, decode_line, encode_line

_ENDING = ".motions.jsonl"


def motion_log_path(state_path: Path) -> Path:
    """Return the path of the log of a rig from that of its state file."""
    return state_path.with_name(state_path.name + _ENDING)


def read_last_motion(state_path: Path) -> dict[str, object] | None:
    """Return the last line of a rig's log; None if there is none, or it is torn or damaged."""
    try:
        lines = read_file(motion_log_path(state_path), MAX_LOG_BYTES).splitlines()
        return decode_line(lines[-1]) if lines else None
    except (OSError, ValueError):
        return None


class MotionLog:
    """The log of a rig.

    Parameters
    ----------
    state_path : Path or None
        The rig's state file; None keeps no log.
    utc : callable
        Returns the calendar time.
    doing : str
        What the rig is used for.
    do : callable
        Does what waits for the disk.
    """

    def __init__(self, state_path: Path | None, utc: Callable[[], datetime], doing: str, do: Do) -> None:
        self._path = None if state_path is None else motion_log_path(state_path)
        self._utc = utc
        self._doing = doing
        self._do = do

    @contextmanager
    def note_motion(self, axis: Axis, what: str) -> Iterator[None]:
        """Log that an axis is about to do `what`, and its position when the block ends in any way.

        An error of the block has priority, even if the log can no longer be written.

        Raises
        ------
        DiskError
            Before the block, if the log cannot be written: nothing has moved.
        """
        self._append("start", axis, what=what, doing=self._doing, by=_find_person())
        try:
            yield
        except LabrigError as error:
            with suppress(DiskError):
                self._append("end", axis, what=what, outcome=error.message)
            raise
        self._append("end", axis, what=what, outcome="done")

    def _append(self, kind: str, axis: Axis, **fields: object) -> None:
        if self._path is None:
            return
        line = encode_line(
            {
                "kind": kind,
                "utc": self._utc().isoformat(timespec="seconds"),
                "axis": axis.name,
                "position": _read_position(axis),
                "unit": axis.unit,
                "referenced": axis.referenced,
                **fields,
            }
        )
        try:
            self._do(partial(_append_whole, self._path, line))
        except OSError as error:
            raise DiskError(
                f"cannot write {self._path}, the log of what was moved by hand: {error.strerror}",
                "check free space and permissions beside the rig's state file",
            ) from error


def _append_whole(path: Path, line: bytes) -> None:
    """Append a line and force it to disk; a line torn by a power cut is cut off."""
    log = LineFile.reopen(path) if path.exists() else LineFile.create(path)
    with closing(log):
        log.append(line)
        log.sync()


def _read_position(axis: Axis) -> float | None:
    """Return the position [mm or rad], from the drive's counter without a reference; None if it does not answer."""
    try:
        return axis.read().position
    except MachineError:
        return None


def _find_person() -> str:
    try:
        name = getpass.getuser()
    except (OSError, KeyError):
        name = "an account without a name"
    return f"{name} on {platform.node()}"
