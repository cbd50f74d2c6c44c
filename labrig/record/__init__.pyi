from .annotations import (
    Annotations,
    Judgement,
    Note,
    judge_run,
    note_on_run,
    read_annotations,
    tag_run,
)
from .can_log import CanFrame
from .catalogue import FoundRun, RunSummary, find_runs, list_runs
from .check import Verdict, check_run
from .difference import Difference, compare_runs, differing_values
from .durable import require_free_bytes, write_atomically
from .events import (
    Event,
    FrameLine,
    Move,
    MoveDone,
    OperatorQuestion,
    PictureRole,
    RecordedTrial,
    RunResume,
    RunStart,
    RunStop,
    TrialStart,
    TrialStop,
    WithdrawalStart,
    WithdrawalStop,
)
from .journal import Journal
from .json_lines import as_recorded, decode_line, encode_document, encode_line
from .layout import WITHDRAWS, picture_file, run_lock
from .lock import FileLock, LockOwner, lock_owner
from .manifest import read_manifest
from .pictures import RecordedPicture, picture_count
from .places import as_url, is_url, output_folder, require_local, require_local_run
from .provenance import collect_code_diff, collect_provenance
from .reader import Frames, Run, local_folder, open_run
from .repair import repair_run
from .tables import with_numbers_apart
from .writer import Recorder

__all__ = [
    "WITHDRAWS",
    "Annotations",
    "CanFrame",
    "Difference",
    "Event",
    "FileLock",
    "FoundRun",
    "FrameLine",
    "Frames",
    "Journal",
    "Judgement",
    "LockOwner",
    "Move",
    "MoveDone",
    "Note",
    "OperatorQuestion",
    "PictureRole",
    "RecordedPicture",
    "RecordedTrial",
    "Recorder",
    "Run",
    "RunResume",
    "RunStart",
    "RunStop",
    "RunSummary",
    "TrialStart",
    "TrialStop",
    "Verdict",
    "WithdrawalStart",
    "WithdrawalStop",
    "as_recorded",
    "as_url",
    "check_run",
    "collect_code_diff",
    "collect_provenance",
    "compare_runs",
    "decode_line",
    "differing_values",
    "encode_document",
    "encode_line",
    "find_runs",
    "is_url",
    "judge_run",
    "list_runs",
    "local_folder",
    "lock_owner",
    "note_on_run",
    "open_run",
    "output_folder",
    "picture_count",
    "picture_file",
    "read_annotations",
    "read_manifest",
    "repair_run",
    "require_free_bytes",
    "require_local",
    "require_local_run",
    "run_lock",
    "tag_run",
    "with_numbers_apart",
    "write_atomically",
]
