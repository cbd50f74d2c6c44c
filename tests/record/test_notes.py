"""What people say of a run."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from labrig.errors import InputError, RecordError
from labrig.record.check import check_run
from labrig.record.notes import annotate_run, read_annotations
from tests.record.runs import closed_run


def test_tags_notes_and_a_verdict_are_kept(tmp_path: Path) -> None:
    """They add up, the last verdict counts, and the record stays as it is."""
    run = closed_run(tmp_path)
    annotate_run(run, tags=["pilot", "gel 10"], note="it slipped", verdict="bad", by="me")
    annotate_run(run, tags=["pilot"], untag=["gel 10"], note="not in trial 2", verdict="doubtful", by="you")
    found = read_annotations(run)
    assert (found.tags, found.verdict) == (("pilot",), "doubtful")
    assert [(note.text, note.by) for note in found.notes] == [("it slipped", "me"), ("not in trial 2", "you")]
    assert (check_run(run).damage, check_run(run).notices) == ((), ())


def test_those_who_annotate_at_once_lose_nothing(tmp_path: Path) -> None:
    """One after the other."""
    run = closed_run(tmp_path)
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(lambda number: annotate_run(run, note=str(number), by="me"), range(12)))
    assert {note.text for note in read_annotations(run).notes} == {str(number) for number in range(12)}


@pytest.mark.parametrize(
    ("what", "match"),
    [
        ({"tags": ["a/b"]}, "the tag"),
        ({"untag": ["other"]}, "has no tag other"),
        ({"note": "  "}, "1 to 10000 characters"),
        ({"note": "x" * 10_001}, "1 to 10000 characters"),
        ({"verdict": "fine"}, "must be good, doubtful, bad"),
    ],
)
def test_what_cannot_be_said_is_refused(tmp_path: Path, what: dict[str, object], match: str) -> None:
    """Nothing is written then."""
    run = closed_run(tmp_path)
    with pytest.raises(InputError, match=match):
        annotate_run(run, by="me", **what)  # type: ignore[arg-type]
    assert not (run / "notes.json").exists()


@pytest.mark.parametrize("text", ["", "[]", '{"tags": 1, "notes": [], "verdict": null}', '{"notes": [1]}'])
def test_notes_that_cannot_be_read_are_refused(tmp_path: Path, text: str) -> None:
    """They are not overwritten either."""
    run = closed_run(tmp_path)
    (run / "notes.json").write_text(text)
    with pytest.raises(RecordError, match=r"notes\.json is damaged"):
        annotate_run(run, note="x", by="me")
    assert (run / "notes.json").read_text() == text
