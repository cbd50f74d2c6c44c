"""The names of files in a run, and the rules for names; writer and reader share them."""

import hashlib
import unicodedata
from pathlib import Path

from labrig.errors import InputError, RecordError
from labrig.input_file import open_file

SCHEMA_VERSION = 1
COPY_HINT = "take the file from a copy of the run"

MANIFEST = "manifest.json"
PROTOCOL = "protocol.yaml"
RIG = "rig.yaml"
CODE_DIFF = "code.diff"
CALIBRATION = "calibration"
FRAMES = "frames"
SHA256SUMS = "SHA256SUMS"
ANALYSIS = "analysis"
REPORT, VIEW = "report.html", "view.rrd"

FRAME_LINES = "frames.jsonl"
STATE_LINES = "states.jsonl"
EVENT_LINES = "events.jsonl"
TRIAL_START, TRIAL_STOP, RUN_STOP = "trial_start", "trial_stop", "run_stop"
SKIP, REPEAT, MARK_BAD, NOTE, UNDO = "skip", "repeat", "mark_bad", "note", "undo"
TRUTH_LINES = "truth.jsonl"
DEVICE_LINES = "devices.jsonl"
"""What the devices said of themselves when a session began and when it ended."""
ALWAYS_PRESENT = (FRAME_LINES, STATE_LINES, EVENT_LINES)
SEQUENCED = frozenset({FRAME_LINES, STATE_LINES, EVENT_LINES, TRUTH_LINES})
"""Files whose lines say their place in the order of all lines, `seq`: what was asked and answered, in order."""
CAN_LOG = "can.log"
NOTES = "notes.json"
LOCK = ".lock"
RESERVE = ".reserve"
CONTROL = ".control"
CAMPAIGN = "campaign.json"
"""In the folder of a campaign, which is no run, but is locked and takes requests as one."""

# ext4, XFS and most others allow 255 bytes; the rest is for the suffix of a temporary name.
_MAX_NAME_BYTES = 200


def picture_file(frame: int, suffix: str = ".png") -> str:
    """Return the file of the picture with this number, relative to the run."""
    return f"{FRAMES}/{frame:06d}{suffix}"


def run_lock(run: Path) -> Path:
    """Return the lock file that the writer of a run holds."""
    return run / LOCK


def run_control(run: Path) -> Path:
    """Return the file in which a run takes requests while it is made. Raises `RecordError` if it is a link."""
    return inside(run, CONTROL)


def session_diff(number: int) -> str:
    """Return the file with the code differences of a later session; the first session has code.diff."""
    return f"code.{number:03d}.diff"


def require_name(name: str, what: str) -> str:
    """Return `name` if it is valid as a file or folder name; inner blanks and non-ASCII letters are allowed.

    Raises
    ------
    InputError
        When it is empty, too long, begins with a dot, begins or ends with a blank, or holds a path separator or a
        control character.
    """
    fault = _find_fault(name)
    if fault:
        raise InputError(f"{what} {name!r} {fault}", "choose a name of letters, digits, '-' and '_'")
    return name


def _find_fault(name: str) -> str:
    if not name or name != name.strip() or name.startswith("."):
        return "is empty, or begins with a dot or a blank, or ends with a blank"
    if any(char in "/\\" or unicodedata.category(char) in {"Cc", "Cs", "Zl", "Zp"} for char in name):
        return "holds a path separator or a control character"
    if len(name.encode()) > _MAX_NAME_BYTES:
        return f"has {len(name.encode())} bytes; {_MAX_NAME_BYTES} are allowed"
    return ""


def inside(run: Path, relative: str) -> Path:
    """Return the path of a file of a run.

    Raises
    ------
    RecordError
        When it, or a folder on the way to it, is a symbolic link.
    """
    path = run
    for part in relative.split("/"):
        path = path / part
        if _is_link(path):
            raise RecordError(
                f"{path} is a symbolic link", "a record holds its files itself; no link in it is followed"
            )
    return path


def _is_link(path: Path) -> bool:
    try:
        return path.is_symlink()
    except OSError as error:  # longer than a name can be
        raise RecordError(f"{path.name[:80]}... cannot be a file: {error.strerror}", COPY_HINT) from error


WITHDRAWS = "withdraws"
"""Key in the manifest of a withdrawal: the run whose needle it withdraws."""


def hash_file(path: Path) -> str:
    """Return the SHA-256 of a file. Raises `RecordError` if it cannot be read."""
    try:
        with open_file(path) as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError as error:
        raise RecordError(f"cannot read {path}: {error.strerror}", COPY_HINT) from error
