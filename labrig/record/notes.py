"""What people say of a run: tags, notes and a verdict, in notes.json. It may be rewritten; no checksum covers it."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Literal, get_args

from pydantic import TypeAdapter

from labrig.durable import write_atomically
from labrig.errors import InputError, RecordError
from labrig.input_file import read_file
from labrig.record.json_lines import encode_document
from labrig.record.layout import NOTES, inside, read_manifest, require_name
from labrig.record.lock import FileLock

Judgement = Literal["good", "doubtful", "bad"]
_MAX_TEXT = 10_000


@dataclass(frozen=True)
class Note:
    """A note, its author and its time (ISO 8601, UTC)."""

    text: str
    by: str
    at: str


@dataclass(frozen=True)
class Annotations:
    """What people say of a run: tags and notes in the order in which they were added, and whether it can be trusted."""

    tags: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    verdict: str | None = None


_READER = TypeAdapter(Annotations)


def read_annotations(run: Path) -> Annotations:
    """Return the annotations of a run; none if nobody made any. Raises `RecordError` when notes.json is damaged."""
    path = inside(run, NOTES)
    try:
        return _READER.validate_json(read_file(path))
    except FileNotFoundError:
        return Annotations()
    except (OSError, ValueError) as error:
        raise RecordError(f"{path} is damaged: {error}", "correct it, or remove it") from error


def annotate_run(
    run: Path,
    *,
    tags: Sequence[str] = (),
    untag: Sequence[str] = (),
    note: str | None = None,
    verdict: Judgement | None = None,
    by: str,
    at: datetime | None = None,
) -> Annotations:
    """Put tags on a run or take them off, add a note, judge it; return all its annotations.

    Raises
    ------
    InputError
        When a name cannot be a tag, a tag to take off is not there, or a note is empty or too long.
    RecordError, LockedError, DiskError
        When the folder is no run, its notes are damaged, or it cannot be written now.
    """
    for tag in tags:
        require_name(tag, "the tag")
    if note is not None and not 0 < len(note.strip()) <= _MAX_TEXT:
        raise InputError(f"a note has 1 to {_MAX_TEXT} characters; this one has {len(note.strip())}")
    if verdict is not None and verdict not in get_args(Judgement):
        raise InputError(f"the verdict is {verdict!r}; it must be {', '.join(get_args(Judgement))}")
    read_manifest(run)  # refuses a folder that is no run
    with FileLock(run / f".{NOTES}.lock").acquire("labrig runs annotate"):
        found = read_annotations(run)
        if missing := [tag for tag in untag if tag not in found.tags]:
            raise InputError(
                f"{run} has no tag {', '.join(missing)}", f"it has: {', '.join(found.tags) or 'none'}"
            )
        kept = [tag for tag in dict.fromkeys((*found.tags, *tags)) if tag not in untag]
        at_utc = (at or datetime.now(UTC)).astimezone(UTC).isoformat(timespec="seconds")
        added = () if note is None else (Note(note, by, at_utc),)
        changed = Annotations(tuple(kept), (*found.notes, *added), verdict or found.verdict)
        write_atomically(inside(run, NOTES), encode_document(asdict(changed)))
    return changed
