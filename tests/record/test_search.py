"""Searching runs."""

import contextlib
import json
import shutil
import sqlite3
from pathlib import Path

import pytest

from labrig.errors import InputError
from labrig.record.annotations import note_on_run
from labrig.record.json_lines import encode_document
from labrig.record.run_index import INDEX_FILE
from labrig.record.search import find_runs
from tests.record.runs import ENDED, add_result, closed_run, without_chain


def test_runs_are_found_by_manifest_protocol_result_and_notes(tmp_path: Path) -> None:
    """A condition may name any value of a run; what it is sorted by comes with it."""
    for seed in (3, 1, 2):
        run = closed_run(tmp_path, f"run {seed}", seed=seed, operator="Chen")
        add_result(run, encode_document({"mean_radius_mm": 27.0 + seed / 10}))
    note_on_run(tmp_path / "run 2", "cloudy gel", revises=None, by="Chen", at=ENDED)
    found = find_runs(tmp_path, "operator=Chen and diameter_mm=1.2 and seed>1", "mean_radius_mm")
    assert [(run.summary.run.name, run.fields["mean_radius_mm"]) for run in found] == [
        ("run 2", (27.2,)),
        ("run 3", (27.3,)),
    ]
    assert [found.summary.run.name for found in find_runs(tmp_path, "note ~ CLOUDY")] == ["run 2"]
    assert [found.summary.run.name for found in find_runs(tmp_path, None, "seed", reverse=True)] == [
        "run 3",
        "run 2",
        "run 1",
    ]


def test_a_new_result_is_found_at_once(tmp_path: Path) -> None:
    """The numbers of the newest result count, also when it was made after the index."""
    run = closed_run(tmp_path)
    for radius_mm in (27.0, 28.0):
        add_result(run, encode_document({"mean_radius_mm": radius_mm}))
        assert len(find_runs(tmp_path, f"mean_radius_mm={radius_mm}")) == 1


def test_an_unknown_field_is_named_with_those_that_there_are(tmp_path: Path) -> None:
    """A field that no run has is refused for the condition and for the order; an empty folder has no say."""
    assert find_runs(tmp_path, "colour=red") == []
    closed_run(tmp_path)
    with pytest.raises(InputError, match="--where, character 1: no run has a field 'colour'"):
        find_runs(tmp_path, "colour=red")
    with pytest.raises(InputError, match="--sort: no run has a field 'colour'"):
        find_runs(tmp_path, sort="colour")


def test_a_search_makes_a_spoilt_index_again(tmp_path: Path) -> None:
    """With pages of the index cut off or overwritten, or a field in it that is no JSON, the runs found are the same."""
    for seed in (1, 2, 3):
        closed_run(tmp_path, f"run {seed}", seed=seed)
    expected = find_runs(tmp_path, "seed>1 and diameter_mm=1.2", "seed")
    assert [run.fields["seed"] for run in expected] == [(2,), (3,)]
    index = tmp_path / INDEX_FILE
    good = index.read_bytes()
    for spoilt in (
        good[: len(good) // 2],
        good[:4096] + bytes(len(good) - 4096),
        good.replace(b"[2]", b"[2["),
    ):
        assert spoilt != good
        index.write_bytes(spoilt)
        assert find_runs(tmp_path, "seed>1 and diameter_mm=1.2", "seed") == expected
        assert len(index.read_bytes()) == len(good)


def test_a_folder_that_cannot_be_written_is_searched(tmp_path: Path) -> None:
    """Where another process writes the index, and without one that can be written, the same runs are found."""
    closed_run(tmp_path, "run 1", seed=1)
    assert len(find_runs(tmp_path, "seed=1")) == 1
    closed_run(tmp_path, "run 2", seed=2)
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX_FILE)) as index:
        index.execute("BEGIN EXCLUSIVE")
        assert [found.summary.run.name for found in find_runs(tmp_path, "seed>0", "seed")] == [
            "run 1",
            "run 2",
        ]
    (tmp_path / INDEX_FILE).unlink()
    (tmp_path / INDEX_FILE).mkdir()
    assert [found.summary.run.name for found in find_runs(tmp_path, "seed>0", "seed")] == ["run 1", "run 2"]


def test_the_index_forgets_the_fields_of_runs_that_are_gone(tmp_path: Path) -> None:
    """A run that was removed, and the fields that a run has no more, leave nothing behind."""
    for name in ("one", "two"):
        closed_run(tmp_path, name)
    result = add_result(without_chain(tmp_path / "one"), encode_document({"mean_radius_mm": 27.0}))
    assert len(find_runs(tmp_path, "seed=7")) == 2
    shutil.rmtree(tmp_path / "two")
    shutil.rmtree(result)
    assert len(find_runs(tmp_path, "seed=7")) == 1
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX_FILE)) as index:
        query = "SELECT name, text FROM leaves JOIN runs USING (run) JOIN paths USING (path)"
        left = set(index.execute(query))
    assert {name for name, _ in left} == {b"one"}
    assert (b"one", "seed") in left
    assert (b"one", "result.mean_radius_mm") not in left


def test_a_search_reads_only_the_fields_that_it_asks_for(tmp_path: Path) -> None:
    """What a condition does not name is not looked at in the index: spoilt there, it brings no run to be read again."""
    closed_run(tmp_path)
    assert len(find_runs(tmp_path, "seed=7")) == 1
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX_FILE)) as index, index:
        paths = index.execute("SELECT path FROM paths WHERE text = 'operator'").fetchone()
        index.execute("UPDATE leaves SET leaf = 'spoilt' WHERE path = ?", paths)
        before = list(index.iterdump())
    assert len(find_runs(tmp_path, "seed=7")) == 1
    with contextlib.closing(sqlite3.connect(tmp_path / INDEX_FILE)) as index:
        assert list(index.iterdump()) == before


def test_sections_of_a_protocol_say_what_the_whole_says(tmp_path: Path) -> None:
    """Fields are found alike in a protocol that falls apart into sections, and in one that does not."""
    for name, text in {
        "sections": "seed: 7\nneedle: {diameter_mm: 1.2}\nspecimens:\n- gelatin_percent: 10\n",
        "one piece": "{seed: 7,\nneedle: {diameter_mm: 1.2},\nspecimens: [{gelatin_percent: 10}]}\n",
        "a remark": "# a gel\nseed: 7\nneedle:\n  # thin\n  diameter_mm: 1.2\nspecimens: [{gelatin_percent: 10}]\n",
        "no YAML": "seed: 7\nneedle: {diameter_mm: 1.2\nspecimens: [{gelatin_percent: 10}]\n",
        "a key twice": "seed: 7\nneedle: {diameter_mm: 1.2}\nspecimens: [{gelatin_percent: 10}]\nseed: 7\n",
    }.items():
        (closed_run(tmp_path, name) / "protocol.yaml").write_text(text)
    found = find_runs(tmp_path, "protocol.seed=7 and diameter_mm=1.2 and gelatin_percent=10", "run")
    assert sorted(run.summary.run.name for run in found) == ["a remark", "one piece", "sections"]


def test_long_lists_of_a_result_do_not_hide_the_rest_of_it(tmp_path: Path) -> None:
    """What stands before and behind the measurements of a result is found; they themselves are not searched."""
    result = {"n": 3, "measurements": [{"score": 1.5}, {"score": 2.5}], "mean_radius_mm": 27.0}
    for name, content in (("indented", encode_document(result)), ("compact", json.dumps(result).encode())):
        add_result(closed_run(tmp_path, name), content)
    assert len(find_runs(tmp_path, "n=3 and mean_radius_mm=27")) == 2
    with pytest.raises(InputError, match="no run has a field 'score'"):
        find_runs(tmp_path, "score=1.5")


def test_a_field_of_the_notes_is_known_before_there_are_notes(tmp_path: Path) -> None:
    """A condition may name tags, verdict and notes before there are any, and finds no other `note` of a record."""
    closed_run(tmp_path, devices={"state": {"note": "by the rig"}})
    for condition in ("tag=pilot", "verdict=good", "note~rig", "verdict_reason~x"):
        assert find_runs(tmp_path, condition) == []
