"""Requests from another terminal to the labrig that makes a run: pause, and continue.

A file stands in the run's folder while the run takes requests. It is empty, or holds `pause` from when a pause is asked
for until the run is to continue. The run looks at it wherever it may pause. Who may write there may ask.
"""

from pathlib import Path
from typing import Literal

from labrig.durable import disk_errors, write_and_rename
from labrig.errors import InputError
from labrig.record.layout import read_manifest, run_control, run_lock
from labrig.record.lock import read_lock_owner


class RunControl:
    """Takes the requests to one run; the caller holds the run's lock.

    Parameters
    ----------
    run : Path
        Its folder.

    Raises
    ------
    DiskError
        When no file can be made there.
    """

    def __init__(self, run: Path) -> None:
        self._file = run_control(run)
        self.note(paused=False)

    @property
    def asks_for_pause(self) -> bool:
        """Whether the run is to pause, or to stay paused."""
        return _is_paused(self._file) is True

    @property
    def asks_to_continue(self) -> bool:
        """Whether a pause is to end; without the file nobody has said so."""
        return _is_paused(self._file) is False

    def note(self, *, paused: bool) -> None:
        """Say whether the run is paused; the requests so far are met."""
        write_and_rename(self._file, b"pause" if paused else b"", sync=False)

    def close(self) -> None:
        """Take no more requests."""
        with disk_errors(self._file):
            self._file.unlink(missing_ok=True)


def _is_paused(file: Path) -> bool | None:
    """Return whether a pause is asked for; None where there is no file, as of a run that cannot pause."""
    try:
        return file.stat().st_size > 0
    except OSError:
        return None


def ask_run(run: Path, order: Literal["pause", "continue"]) -> str:
    """Ask the labrig that makes a run to pause or to continue; return what comes of it as a sentence.

    Raises
    ------
    RecordError
        When the folder is no run, or the place of the requests is a link.
    InputError
        When the run is over, or cannot do it.
    DiskError
        When the request cannot be written.
    """
    ended, owner = read_manifest(run).get("exit_status"), read_lock_owner(run_lock(run))
    if owner is None or ended not in {"incomplete", None}:
        how = "was interrupted" if ended in {"incomplete", None} else f"has ended: {ended}"
        raise InputError(f"{run} is not being made: it {how}", "labrig runs lists the runs that are going on")
    paused = _is_paused(file := run_control(run))
    if paused is None:
        hint = "only labrig run and resume can be paused"
        raise InputError(f"{run} takes no requests: it is made by {owner}", hint)
    if order == "continue" and not paused:
        raise InputError(f"{run}: the run is not paused", "labrig pause RUN pauses it")
    write_and_rename(file, b"pause" if order == "pause" else b"", sync=False)
    if order == "continue":
        return "the run continues"
    return "the run pauses at its next safe point, which its own terminal names, or is paused already"
