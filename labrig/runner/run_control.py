"""Requests from another terminal to the labrig that makes a run: pause, and continue.

They stand in a file of the run's folder while it is made, which holds one word: `running`, `pause` (asked for),
`paused`, or `continue` (asked for). The run looks at it wherever it may pause. Who may write there may ask.
"""

from pathlib import Path
from typing import Literal

from labrig.durable import disk_errors, write_and_rename
from labrig.errors import InputError
from labrig.input_file import read_file
from labrig.record.layout import read_manifest, run_control, run_lock
from labrig.record.lock import read_lock_owner

Order = Literal["pause", "continue"]


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
        self._read_as: tuple[int, int, int] | None = None
        self._word: str | None = None
        self.note(paused=False)

    @property
    def asks_for_pause(self) -> bool:
        """Whether a pause is asked for."""
        return self._read_if_changed() == "pause"

    @property
    def asks_to_continue(self) -> bool:
        """Whether a pause is to end."""
        return self._read_if_changed() == "continue"

    def note(self, *, paused: bool) -> None:
        """Say whether the run is paused; the requests so far are met."""
        write_and_rename(self._file, b"paused" if paused else b"running", sync=False)

    def _read_if_changed(self) -> str | None:
        """Return the word; the run looks ten times a second, and each request is another file."""
        try:
            found = self._file.stat()
        except OSError:
            return None
        stands = found.st_ino, found.st_mtime_ns, found.st_size
        if stands != self._read_as:
            self._read_as, self._word = stands, _read(self._file)
        return self._word

    def close(self) -> None:
        """Take no more requests."""
        with disk_errors(self._file):
            self._file.unlink(missing_ok=True)


def _read(file: Path) -> str | None:
    """Return the word in the file of a run; None where there is none to be read, as of a run that cannot pause."""
    try:
        return read_file(file).decode("utf-8", "replace")
    except OSError:
        return None


def ask_run(run: Path, order: Order) -> str:
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
    ended = read_manifest(run).get("exit_status")
    owner = read_lock_owner(run_lock(run))
    if owner is None or ended not in {"incomplete", None}:
        how = "was interrupted" if ended in {"incomplete", None} else f"has ended: {ended}"
        raise InputError(f"{run} is not being made: it {how}", "labrig runs lists the runs that are going on")
    match order, (stands := _read(file := run_control(run))):
        case _, None:
            raise InputError(
                f"{run} takes no requests: it is made by {owner}",
                "only labrig run and resume can be paused",
            )
        case "pause", "paused":
            return "the run is paused already"
        case "pause", _:
            write_and_rename(file, b"pause", sync=False)
            return "the run pauses at its next safe point, which its own terminal names"
        case "continue", "paused":
            write_and_rename(file, b"continue", sync=False)
            return "the run continues"
        case "continue", "pause":
            write_and_rename(file, b"running", sync=False)
            return "the pause that was asked for is taken back"
    raise InputError(f"{run}: the run is not paused but {stands}", "labrig pause RUN pauses it")
