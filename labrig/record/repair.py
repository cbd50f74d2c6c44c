"""Close an interrupted run as it is."""

from datetime import datetime
from pathlib import Path

from labrig.record.json_lines import read_lines
from labrig.record.layout import EVENT_LINES, LOCK, RUN_STOP
from labrig.record.lock import FileLock
from labrig.record.manifest import read_manifest
from labrig.record.sealing import finish_closing, seal_leftovers
from labrig.record.writer import EXIT_STATUSES, Recorder

_REASON = "interrupted: labrig ended without closing the run; closed by labrig runs check --repair"


def repair_run(run: Path, ended: datetime) -> bool:
    """Close an interrupted run: torn ends are set aside, everything else stays, nothing is deleted.

    A run that had recorded its end keeps that status; any other is closed as `aborted`. Results and annotations of a
    closed run that have no link get one, of the kind `unsealed`. Returns whether there was something to do.

    Raises
    ------
    RecordError
        When it is no run, or is damaged.
    LockedError
        While another process writes it.
    DiskError
        When it cannot be written.
    """
    if read_manifest(run).get("exit_status") != "incomplete":
        return seal_leftovers(run, ended)
    with FileLock(run / LOCK).acquire("labrig runs check --repair"):
        if finish_closing(run):
            return True
    recorder = Recorder.reopen(run, "labrig runs check --repair")
    exit_status, reason = _find_ending(run)
    recorder.close(exit_status, reason, ended)
    return True


def _find_ending(run: Path) -> tuple[str, str]:
    """Return status and reason from the last event if the run was killed between its end and its closing."""
    last = (read_lines(run / EVENT_LINES) or [{}])[-1]
    exit_status = last.get("exit_status")
    if last.get("kind") == RUN_STOP and exit_status in EXIT_STATUSES:
        return str(exit_status), str(last.get("reason", ""))
    return "aborted", _REASON
