from labrig.record.annotations import (
    Annotations,
    Judgement,
    Note,
    judge_run,
    note_on_run,
    read_annotations,
    tag_run,
)
from labrig.record.can_log import CanFrame
from labrig.record.catalogue import FoundRun, RunSummary, find_runs, list_runs
from labrig.record.check import Verdict, check_run
from labrig.record.difference import Difference, compare_runs, differing_values
from labrig.record.durable import require_free_bytes, write_atomically
from labrig.record.journal import Journal
from labrig.record.json_lines import as_recorded, decode_line, encode_document, encode_line
from labrig.record.layout import WITHDRAWS, picture_file, run_lock
from labrig.record.lock import FileLock, LockOwner, lock_owner
from labrig.record.pictures import RecordedPicture, picture_count
from labrig.record.places import is_url, output_folder, require_local
from labrig.record.provenance import collect_code_diff, collect_provenance
from labrig.record.reader import Frames, Run, open_run
from labrig.record.repair import repair_run
from labrig.record.tables import with_numbers_apart
from labrig.record.writer import Recorder

__all__ = [
    "WITHDRAWS",
    "Annotations",
    "CanFrame",
    "Difference",
    "FileLock",
    "FoundRun",
    "Frames",
    "Journal",
    "Judgement",
    "LockOwner",
    "Note",
    "RecordedPicture",
    "Recorder",
    "Run",
    "RunSummary",
    "Verdict",
    "as_recorded",
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
    "lock_owner",
    "note_on_run",
    "open_run",
    "output_folder",
    "picture_count",
    "picture_file",
    "read_annotations",
    "repair_run",
    "require_free_bytes",
    "require_local",
    "run_lock",
    "tag_run",
    "with_numbers_apart",
    "write_atomically",
]
