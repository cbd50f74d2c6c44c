"""Annotations of a run: tags, notes and verdict."""

from pathlib import Path

import pytest

from labrig.errors import InputError, LockedError, RecordError
from labrig.record.annotations import Annotations, judge_run, note_on_run, read_annotations, tag_run
from labrig.record.lock import FileLock
from labrig.record.reader import open_run
from tests.record.runs import ENDED, closed_run, interrupted_run, without_chain


def _note(run: Path, text: str, revises: int | None = None) -> Annotations:
    return note_on_run(run, text, revises=revises, by="Chen", at=ENDED)


def test_a_note_keeps_its_revisions(tmp_path: Path) -> None:
    """The newest revision counts, the older ones stay readable, each with its author and time."""
    run = closed_run(tmp_path)
    _note(run, "gel was cloudy")
    _note(run, "needle bent")
    annotations = _note(run, "gel 3 was cloudy", revises=1)
    assert [(note.note, note.revision, note.text) for note in annotations.notes] == [
        (1, 2, "gel 3 was cloudy"),
        (2, 1, "needle bent"),
    ]
    assert [note.text for note in annotations.revisions] == [
        "gel was cloudy",
        "needle bent",
        "gel 3 was cloudy",
    ]
    assert (annotations.notes[0].by, annotations.notes[0].at) == ("Chen", "2026-03-02T09:45:00+00:00")


def test_tags_and_verdict_stand_as_last_said(tmp_path: Path) -> None:
    """A tag can be taken off, a verdict replaced; the file keeps every word."""
    run = closed_run(tmp_path)
    tag_run(run, ["pilot", "größe 2"], remove=False, by="Chen", at=ENDED)
    tag_run(run, ["pilot"], remove=True, by="Yang", at=ENDED)
    judge_run(run, "bad", "", by="Chen", at=ENDED)
    judge_run(run, "doubtful", "cloudy", by="Chen", at=ENDED)
    annotations = read_annotations(run)
    assert (annotations.tags, annotations.verdict, annotations.verdict_reason) == (
        ("größe 2",),
        "doubtful",
        "cloudy",
    )
    assert len((run / "notes.jsonl").read_bytes().splitlines()) == 5


def test_remarks_leave_the_record_as_it_was(tmp_path: Path) -> None:
    """A closed run with remarks opens without a problem; its chain is longer."""
    run = closed_run(tmp_path)
    before = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    _note(run, "fine")
    after = {path.name: path.read_bytes() for path in run.iterdir() if path.is_file()}
    assert after.pop("notes.jsonl")
    assert after.pop("chain.jsonl").startswith(before.pop("chain.jsonl"))
    assert after == before
    assert open_run(run).problems == ()


def test_a_torn_remark_is_dropped_and_not_continued(tmp_path: Path) -> None:
    """After a kill in the middle of a line the next remark begins on a line of its own."""
    run = interrupted_run(tmp_path)
    _note(run, "first")
    whole = (run / "notes.jsonl").read_bytes()
    for number, cut in enumerate((1, 2, 30), start=1):
        with (run / "notes.jsonl").open("ab") as notes:
            notes.write(whole[:-cut])
        assert len(read_annotations(run).revisions) == number
        said = _note(run, "next")
        assert [note.text for note in said.revisions] == ["first", *["next"] * number]


def test_without_a_chain_a_remark_that_lacks_its_newline_is_kept(tmp_path: Path) -> None:
    """In a record of an earlier labrig only the newline of the last remark may be lost; nothing else is taken in."""
    run = without_chain(closed_run(tmp_path))
    _note(run, "first")
    whole = (run / "notes.jsonl").read_bytes()
    for cut in (1, 2, 30):
        (run / "notes.jsonl").write_bytes(whole + whole[:-cut])
        annotations = _note(run, "second")
        assert [note.text for note in annotations.revisions] == (
            ["first", "first", "second"] if cut == 1 else ["first", "second"]
        )
    assert not (run / "chain.jsonl").exists()


def test_a_flipped_bit_is_named(tmp_path: Path) -> None:
    """A damaged remark is refused with file and line, by readers and before anything is added."""
    run = closed_run(tmp_path)
    _note(run, "first")
    notes = run / "notes.jsonl"
    notes.write_bytes(notes.read_bytes().replace(b"first", b"worst"))
    with pytest.raises(RecordError, match=r"notes\.jsonl:1"):
        _note(run, "second")


def test_what_makes_no_sense_is_refused(tmp_path: Path) -> None:
    """An empty note, a revision of no note, a tag that is not on, and a folder that is no run are named."""
    run = closed_run(tmp_path)
    with pytest.raises(InputError, match="1 to 10000 characters"):
        _note(run, " ")
    with pytest.raises(InputError, match="no note 3"):
        _note(run, "text", revises=3)
    with pytest.raises(InputError, match="no tag pilot"):
        tag_run(run, ["pilot"], remove=True, by="Chen", at=ENDED)
    with pytest.raises(RecordError, match="is no run"):
        _note(tmp_path, "text")
    assert not (run / "notes.jsonl").exists()


def test_two_at_once_are_kept_apart(tmp_path: Path) -> None:
    """While one command adds a remark another is refused and told by whom."""
    run = closed_run(tmp_path)
    with (
        FileLock(run / ".notes.jsonl.lock").acquire("labrig runs"),
        pytest.raises(LockedError, match="in use by"),
    ):
        _note(run, "text")


def test_a_link_is_not_written_through(tmp_path: Path) -> None:
    """notes.jsonl that is a link out of the run is refused, and its target stays as it was."""
    run = closed_run(tmp_path / "runs")
    outside = tmp_path / "outside"
    outside.write_text("")
    (run / "notes.jsonl").symlink_to(outside)
    with pytest.raises(RecordError, match="symbolic link"):
        _note(run, "text")
    assert outside.read_text() == ""


def test_a_run_of_a_newer_schema_is_left_alone(tmp_path: Path) -> None:
    """What its notes look like is not known: it is refused, and nothing is written."""
    run = closed_run(tmp_path)
    manifest = run / "manifest.json"
    manifest.write_bytes(manifest.read_bytes().replace(b'"schema_version": 1', b'"schema_version": 99'))
    with pytest.raises(RecordError, match="schema version 99"):
        _note(run, "gel was cloudy")
    assert not (run / "notes.jsonl").exists()
