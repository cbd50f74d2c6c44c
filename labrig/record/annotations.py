"""Annotations of a run: tags, notes with their revisions, and the operator's verdict.

`RUN/notes.jsonl` is append-only, one CRC line a remark. SHA256SUMS does not cover it, because it grows after the run is
closed; a link of the run's chain covers it after each remark. Nothing in it is ever changed or removed: a new line with
the same number revises a note, an `untag` line takes a tag off, a later verdict replaces an earlier one. So it stays
readable who wrote what and when.
"""

import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from pathlib import Path
from typing import Literal

from labrig.durable import append_or_restore, disk_errors, open_descriptor
from labrig.errors import InputError, Problem, RecordError
from labrig.input_file import MAX_LOG_BYTES, read_file
from labrig.posix import sync_directory
from labrig.record.json_lines import decode_line, encode_line, read_lines
from labrig.record.layout import NOTES, inside, require_name
from labrig.record.lock import FileLock
from labrig.record.manifest import read_manifest
from labrig.record.seal import Seal, count_unsealed_notes, measure_sealed_notes, read_seal
from labrig.record.sealing import seal_notes

Judgement = Literal["good", "doubtful", "bad"]
_MAX_TEXT = 10_000


@dataclass(frozen=True)
class Note:
    """The current text of a note, its number and revision, its author and its time (ISO 8601, UTC)."""

    note: int
    revision: int
    text: str
    by: str
    at: str


@dataclass(frozen=True)
class Annotations:
    """All annotations of a run as they are now.

    Attributes
    ----------
    tags : tuple of str
        In the order in which they were added.
    notes : tuple of Note
        The newest revision of each, sorted by number.
    verdict : str or None
        The operator's verdict: good, doubtful or bad.
    verdict_reason : str or None
        The reason for it.
    revisions : tuple of Note
        Every revision of every note, oldest first.
    """

    tags: tuple[str, ...] = ()
    notes: tuple[Note, ...] = ()
    verdict: str | None = None
    verdict_reason: str | None = None
    revisions: tuple[Note, ...] = ()


def read_annotations(run: Path, seal: Seal | None = None) -> Annotations:
    """Return the annotations of a run; of a run with a chain, the lines that it covers.

    The seal is read if it is not given.

    Raises
    ------
    RecordError
        When a line of notes.jsonl is damaged, or lines were changed or removed since they were sealed.
    """
    path = inside(run, NOTES)
    lines = read_lines(path) if path.exists() else []
    seal = seal or read_seal(run)
    if seal.links:
        if NOTES not in seal.newest:
            return Annotations()
        seal.require_unchanged(NOTES)
        lines = lines[: read_file(path, MAX_LOG_BYTES)[: measure_sealed_notes(seal)].count(b"\n")]
    return _join_remarks(lines, path)


def without_authors(annotations: Annotations) -> Annotations:
    """Return the annotations without the names of those who made them."""
    return replace(
        annotations,
        notes=tuple(replace(note, by="") for note in annotations.notes),
        revisions=tuple(replace(note, by="") for note in annotations.revisions),
    )


def find_damaged_annotations(run: Path) -> tuple[Problem, ...]:
    """Return why the annotations of a run cannot be used; nothing if they can."""
    try:
        read_annotations(run)
    except RecordError as error:
        return (Problem(NOTES, error.message, error.hint),)
    return ()


def tag_run(run: Path, tags: Sequence[str], *, remove: bool, by: str, at: datetime) -> Annotations:
    """Put tags on a run, or take them off.

    Raises
    ------
    InputError
        When a name cannot be a tag, or a tag to take off is not there.
    RecordError, LockedError, DiskError
        When the folder is no run, its schema is newer, or it cannot be written now.
    """
    for tag in tags:
        require_name(tag, "the tag")
    kind = "untag" if remove else "tag"
    with _Remarks(run, by, at) as remarks:
        missing = [tag for tag in tags if remove and tag not in remarks.now.tags]
        if missing:
            raise InputError(
                f"{run} has no tag {', '.join(missing)}", f"it has: {', '.join(remarks.now.tags) or 'none'}"
            )
        return remarks.add([{"kind": kind, "tag": tag} for tag in tags])


def note_on_run(run: Path, text: str, *, revises: int | None, by: str, at: datetime) -> Annotations:
    """Add a note, or a new revision of note number `revises`; older revisions are kept.

    Raises
    ------
    InputError
        When the text is empty or too long, or no note has that number.
    """
    _check_text(text)
    with _Remarks(run, by, at) as remarks:
        revisions = {note.note: note.revision for note in remarks.now.notes}
        if revises is not None and revises not in revisions:
            numbers = ", ".join(map(str, revisions)) or "none"
            raise InputError(f"{run} has no note {revises}", f"it has: {numbers}")
        number = max(revisions, default=0) + 1 if revises is None else revises
        revision = revisions.get(number, 0) + 1
        return remarks.add([{"kind": "note", "note": number, "revision": revision, "text": text}])


def judge_run(run: Path, verdict: Judgement, reason: str, *, by: str, at: datetime) -> Annotations:
    """Record whether a run can be trusted; the last verdict counts."""
    if reason:
        _check_text(reason)
    with _Remarks(run, by, at) as remarks:
        return remarks.add([{"kind": "verdict", "verdict": verdict, "reason": reason}])


def _check_text(text: str) -> None:
    if not text.strip() or len(text) > _MAX_TEXT:
        raise InputError(f"a note has 1 to {_MAX_TEXT} characters; this one has {len(text.strip())}")


class _Remarks:
    """notes.jsonl while it is locked for appending."""

    def __init__(self, run: Path, by: str, at: datetime) -> None:
        read_manifest(run)  # refuses a folder that is no run, or has a newer schema
        self._path = inside(run, NOTES)
        self._lock = FileLock(run / f".{NOTES}.lock")
        self._stamp: Mapping[str, object] = {"by": by, "at": at}
        self.now = Annotations()
        self._seal = Seal(run, ())

    def __enter__(self) -> "_Remarks":
        self._lock.acquire("labrig runs")
        try:
            self.now = read_annotations(self._path.parent)
            self._seal = self._require_sealed()
        except RecordError:
            self._lock.release()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def add(self, remarks: Iterable[Mapping[str, object]]) -> Annotations:
        """Append the remarks; they are durable when this returns."""
        lines = b"".join(encode_line({**remark, **self._stamp}) for remark in remarks)
        with disk_errors(self._path):
            with open_descriptor(self._path, os.O_RDWR | os.O_CREAT | os.O_APPEND) as descriptor:
                whole, missing = self._find_end()
                # The torn line of a killed process was never acknowledged; the new line must not continue it.
                os.ftruncate(descriptor, whole)
                append_or_restore(descriptor, missing + lines, whole)
                os.fsync(descriptor)
            sync_directory(self._path.parent)
        seal_notes(self._path.parent, self._stamp["at"])
        return read_annotations(self._path.parent)

    def _require_sealed(self) -> Seal:
        """Return the seal; refuse lines that it does not cover, since a new link would cover them too."""
        seal = read_seal(self._path.parent)
        if seal.links and (lines := count_unsealed_notes(seal)):
            raise RecordError(
                f"{self._path} holds {lines} lines without a link: labrig was stopped, or somebody added them",
                f"labrig runs check {self._path.parent} --repair takes them in",
            )
        return seal

    def _find_end(self) -> tuple[int, bytes]:
        """Return where the next line begins, and the newline to add if only that was torn off."""
        return (measure_sealed_notes(self._seal), b"") if self._seal.links else _find_torn_end(self._path)


def _find_torn_end(path: Path) -> tuple[int, bytes]:
    """Return where the last whole line ends, and the newline to add if only that was torn off."""
    content = read_file(path, MAX_LOG_BYTES)
    rest = content[content.rfind(b"\n") + 1 :]
    try:
        decode_line(rest)
    except ValueError:
        return len(content) - len(rest), b""
    return len(content), b"\n"


def _join_remarks(lines: Sequence[Mapping[str, object]], path: Path) -> Annotations:
    tags: dict[str, None] = {}
    revisions: list[Note] = []
    verdict: tuple[str | None, str | None] = (None, None)
    try:
        for line in lines:
            match line["kind"]:
                case "tag":
                    tags[str(line["tag"])] = None
                case "untag":
                    tags.pop(str(line["tag"]), None)
                case "note":
                    revisions.append(_read_note(line))
                case "verdict":
                    verdict = (str(line["verdict"]), str(line["reason"]) or None)
    except (KeyError, TypeError, ValueError) as error:
        raise RecordError(f"{path} holds a remark that cannot be read: {error}") from error
    newest = {note.note: note for note in revisions}
    return Annotations(
        tuple(tags), tuple(newest[number] for number in sorted(newest)), *verdict, tuple(revisions)
    )


def _read_note(line: Mapping[str, object]) -> Note:
    return Note(
        int(str(line["note"])),
        int(str(line["revision"])),
        str(line["text"]),
        str(line["by"]),
        str(line["at"]),
    )
