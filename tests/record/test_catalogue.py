"""Lists of runs, the language of `labrig runs --where`, and what people say of a run."""

import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from labrig.errors import InputError, RecordError
from labrig.record.catalogue import list_runs
from labrig.record.check import check_run
from labrig.record.condition import parse_condition
from labrig.record.notes import annotate_run, read_annotations
from tests.record.runs import ENDED, add_result, begin, closed_run, fill, interrupted_run

FIELDS: dict[str, Any] = {
    "exit_status": ["success"], "operator": ["Chen Yang"], "started": ["2026-03-02T09:30:00+00:00"], "seed": [7],
    "provenance.git_dirty": [False], "reason": [None], "protocol.specimens.gelatin_percent": [10.0, 13.0],
    "protocol.needle.diameter_mm": [1.2], "result.mean_radius_mm": [27.6],
}  # fmt: skip


@pytest.mark.parametrize(
    ("text", "holds"),
    [
        ("gelatin_percent=13 and exit_status=success", True),
        ("gelatin_percent=16", False),
        ("percent=13", False),
        ("gelatin_percent=10 and gelatin_percent=13", True),
        ("gelatin_percent!=13", False),
        ("gelatin_percent!=16", True),
        ("seed<=7 and not seed<7", True),
        ("seed = 7.0", True),
        ("exit_status=failed or (seed>6 and seed<8)", True),
        ("exit_status=failed or seed>6 and seed>8", False),
        ("operator='Chen Yang'", True),
        ('operator ~ "yang"', True),
        ("started>=2026-03-01 and started<2026-03-03", True),
        ("git_dirty=false", True),
        ("reason=null", True),
        ("reason<1", False),
        ("mean_radius_mm>28", False),
        ("protocol.needle.diameter_mm=1.2", True),
        ("seed>apple", False),
        ("missing!=1", False),
        ("started>2025", True),
        (" or ".join(f"seed={number}" for number in range(900)), True),
    ],
)
def test_a_condition_holds_or_not(text: str, holds: bool) -> None:
    """Comparisons are of numbers or text; of several values one is enough; and binds before or."""
    assert parse_condition(text).fits(FIELDS) is holds


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "character 1: this is no comparison"), ("seed 7", "character 1: this is no comparison"),
        ("seed=", "character 1"), ("seed==7", "character 1"), ("seed=7 exit_status=success", "do not join"),
        ("seed=7 (exit_status=success)", "do not join"), ("seed=7 and", "do not join"),
        ("seed=7 mm", "character 8: this is no comparison"), ("(seed=7", "brackets do not join"),
        ("operator='Chen", "character 1"), ("and=7", "character 1"),
    ],
)  # fmt: skip
def test_what_cannot_be_read_is_refused_with_its_place(text: str, words: str) -> None:
    """The message says at which character the condition stops making sense, and the hint how one is written."""
    with pytest.raises(InputError, match=words) as refusal:
        parse_condition(text)
    assert "equal is one =" in refusal.value.hint


def test_a_field_that_no_run_has_is_refused_with_those_that_there_are() -> None:
    """A misspelt field is named with its place and the one that was probably meant; nonsense means none."""
    for value in ("13", "soft", "'soft gel'"):
        seed, gel = parse_condition(f"seed=7 and gelatine_percent={value}").comparisons
        assert gel.refuse(FIELDS).message == "--where, character 12: no run has a field 'gelatine_percent'"
    assert gel.refuse(FIELDS).hint.startswith("did you mean gelatin_percent? fields: run, protocol")
    assert seed.refuse({"nonsense"}).hint.startswith("fields: run, protocol")


@given(st.text(alphabet="abc=<>!~()'\" 17andor;-", max_size=40))
def test_any_text_is_read_or_refused(text: str) -> None:
    """Nothing that is typed leaves the parser by another way than an answer or a named refusal."""
    with suppress(InputError):
        assert parse_condition(text).fits(FIELDS) in {True, False}


@pytest.fixture
def runs_dir(tmp_path: Path) -> Path:
    """Return a folder of four runs: closed, tagged and measured, interrupted, and damaged."""
    told: Any = [
        {"started": f"2026-03-0{n}T08:00:00+00:00", "protocol": {"gel": {"percent": n}}} for n in (1, 2)
    ]
    closed_run(tmp_path, "first", **told[0])
    second = closed_run(tmp_path, "second", **told[1])
    add_result(second, b'{"mean_radius_mm": 27.5, "measurements": [{"radius_mm": 1}]}')
    annotate_run(second, tags=["pilot"], note="it slipped", verdict="doubtful", by="me")
    interrupted_run(tmp_path, "third")
    (closed_run(tmp_path, "damaged") / "manifest.json").write_text("{")
    (tmp_path / "no run").mkdir()
    (tmp_path / "file").write_text("")
    (tmp_path / "link").symlink_to(second)
    return tmp_path


def test_runs_are_listed_newest_first_and_damaged_last(runs_dir: Path) -> None:
    """With how they ended, how many trials are done, and what people say of them; nothing else is a run."""
    listed = list_runs(runs_dir)
    assert [run.run.name for run in listed] == ["third", "second", "first", "damaged"]
    assert [run.exit_status for run in listed] == ["incomplete", "success", "success", "damaged"]
    assert [(run.trials_done, run.trials_planned) for run in listed] == [(2, 3)] * 3 + [(None, None)]
    assert (listed[1].tags, listed[1].verdict, listed[1].notes) == (("pilot",), "doubtful", 1)
    assert list_runs(runs_dir / "not yet") == []
    with pytest.raises(InputError, match="cannot list"):
        list_runs(runs_dir / "file")


def test_runs_are_found_by_manifest_protocol_notes_and_result(runs_dir: Path) -> None:
    """Fields of the newest result are read only when one is asked for."""

    def find(where):
        return [summary.run.name for summary in list_runs(runs_dir, where)]

    assert find("protocol.gel.percent>=2") == ["second"]
    assert find("tag=pilot and note~SLIP and verdict=doubtful") == ["second"]
    assert find("exit_status!=success") == ["third", "damaged"]
    assert find("mean_radius_mm>27") == ["second"]
    with pytest.raises(InputError, match="no run has a field 'radius_mm'"):
        list_runs(runs_dir, "radius_mm=1")


def test_a_list_reads_one_small_file_a_run(tmp_path: Path) -> None:
    """The manifest, and the notes if there are any; nothing is verified."""
    recorder = begin(tmp_path)
    fill(recorder)
    recorder.close("success", "", ENDED)
    opened: list[str] = []
    watching = True

    def watch(event: str, arguments: tuple[object, ...]) -> None:
        if event == "open" and watching and str(arguments[0]).startswith(str(tmp_path)):
            opened.append(Path(str(arguments[0])).name)

    sys.addaudithook(watch)
    (run,) = list_runs(tmp_path)
    watching = False
    assert run.trials_done == 2
    assert opened == ["manifest.json"]


def test_tags_notes_and_a_verdict_are_kept(tmp_path: Path) -> None:
    """They add up, the last verdict counts, and the record stays as it is."""
    run = closed_run(tmp_path)
    annotate_run(run, tags=["pilot", "gel 10"], note="x" * 10_000, verdict="bad", by="me")
    annotate_run(run, tags=["pilot"], untag=["gel 10"], note="not in trial 2", verdict="doubtful", by="you")
    found = read_annotations(run)
    assert (found.tags, found.verdict) == (("pilot",), "doubtful")
    assert [(note.text, note.by) for note in found.notes] == [("x" * 10_000, "me"), ("not in trial 2", "you")]
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
        ({"tags": ["a/b"]}, "the tag"), ({"untag": ["other"]}, "has no tag other"),
        ({"note": "  "}, "1 to 10000 characters"), ({"note": "x" * 10_001}, "1 to 10000 characters"),
        ({"verdict": "fine"}, "must be good, doubtful, bad"),
    ],
)  # fmt: skip
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
