"""The chain of a run: what is changed, removed or added is named, and what no link covers is not used."""

import json
import multiprocessing
import os
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from labrig.errors import InputError, RecordError
from labrig.record.annotations import judge_run, note_on_run, read_annotations
from labrig.record.catalogue import list_runs
from labrig.record.chain import append_link, find_link, scan_chain
from labrig.record.check import check_run
from labrig.record.json_lines import encode_line
from labrig.record.reader import open_run
from labrig.record.repair import repair_run
from labrig.record.seal import find_root
from labrig.record.search import find_runs
from labrig.record.writer import Recorder
from tests.record.faults import describe_damage, full_run
from tests.record.forgery import edit_line, edit_manifest, redo_chain, redo_hashes
from tests.record.runs import ENDED, add_result, begin, closed_run, fill, picture, without_chain

RESULT = b'{\n  "mean_radius_mm": 27.5\n}\n'


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Return a closed run with a result, a page, two notes and a verdict."""
    path = closed_run(tmp_path)
    add_result(path, RESULT)
    (path / "report.html").write_text("<html></html>")
    open_run(path).seal_page(path / "report.html", ENDED)
    for text in ("first", "second"):
        note_on_run(path, text, revises=None, by="Chen", at=ENDED)
    judge_run(path, "bad", "cloudy", by="Chen", at=ENDED)
    return path


def named(run: Path) -> set[str]:
    """Return the files that a check names, as damage or otherwise."""
    checked = check_run(run)
    return {problem.where.partition(":")[0] for problem in (*checked.damage, *checked.notices)}


def test_a_closed_run_is_sealed_and_each_link_is_the_hash_of_its_line(run: Path) -> None:
    """Its kinds tell what happened; a shell computes the same hashes, and the root is that of the closing."""
    checked = check_run(run)
    assert (checked.damage, checked.notices, checked.seal) == ((), (), "sealed")
    assert [link.kind for link in checked.links] == [
        "open",
        "close",
        "result",
        "page",
        "note",
        "note",
        "note",
    ]
    shell = subprocess.run(
        "sed -n 2p chain.jsonl | sha256sum", shell=True, cwd=run, check=True, capture_output=True, text=True
    )
    assert shell.stdout.split()[0] == find_root(run) == checked.links[1].sha256


def test_the_closing_covers_every_raw_file(run: Path) -> None:
    """Manifest and SHA256SUMS are in the link, and the sums list all others."""
    files = set(check_run(run).links[1].files)
    listed = {line[66:] for line in (run / "SHA256SUMS").read_text().splitlines()}
    later = {"chain.jsonl", "notes.jsonl", "report.html", "analysis/001/result.json"}
    present = {path.relative_to(run).as_posix() for path in run.rglob("*") if path.is_file()}
    assert files | listed == present - later


def _edit_result(run: Path) -> None:
    (run / "analysis/001/result.json").write_bytes(RESULT.replace(b"27.5", b"99.9"))


def _remove_last_note(run: Path) -> None:
    _keep_notes(run, slice(0, 2))


def _remove_middle_note(run: Path) -> None:
    _keep_notes(run, slice(0, 3, 2))


def _keep_notes(run: Path, kept: slice) -> None:
    lines = (run / "notes.jsonl").read_bytes().splitlines(keepends=True)
    (run / "notes.jsonl").write_bytes(b"".join(lines[kept]))


def _swap_pictures(run: Path) -> None:
    first, second = run / "frames/000000.png", run / "frames/000001.png"
    content = first.read_bytes()
    first.write_bytes(second.read_bytes())
    second.write_bytes(content)
    redo_hashes(run)


def _edit_calibration(run: Path) -> None:
    (run / "calibration/intrinsics.json").write_text('{"fx": 2.0}')
    redo_hashes(run)


def _add_mask(run: Path) -> None:
    (run / "calibration/mask.json").write_text("{}")


def _remove_link(run: Path) -> None:
    lines = (run / "chain.jsonl").read_bytes().splitlines(keepends=True)
    (run / "chain.jsonl").write_bytes(b"".join([*lines[:2], *lines[3:]]))


def _close_again(run: Path) -> None:
    lines = (run / "chain.jsonl").read_bytes().splitlines(keepends=True)
    (run / "chain.jsonl").write_bytes(lines[0])


FORGERIES: dict[str, tuple[Callable[[Path], None], str]] = {
    "a result": (_edit_result, "analysis/001/result.json"),
    "the last note removed": (_remove_last_note, "notes.jsonl"),
    "a note in the middle removed": (_remove_middle_note, "notes.jsonl"),
    "all notes removed": (lambda run: (run / "notes.jsonl").unlink(), "notes.jsonl"),
    "the manifest": (lambda run: edit_manifest(run, operator="Yang"), "manifest.json"),
    "the manifest opened again": (lambda run: edit_manifest(run, exit_status="incomplete"), "manifest.json"),
    "a state": (lambda run: edit_line(run / "states.jsonl", 2, insertion_mm=9.0), "states.jsonl"),
    "two pictures swapped": (_swap_pictures, "frames.jsonl"),
    "a calibration": (_edit_calibration, "manifest.json"),
    "a mask added": (_add_mask, "calibration/mask.json"),
    "a link removed": (_remove_link, "chain.jsonl"),
    "the closing removed": (_close_again, "chain.jsonl"),
    "the chain removed": (lambda run: (run / "chain.jsonl").unlink(), "chain.jsonl"),
}


@pytest.mark.parametrize("what", FORGERIES)
def test_what_was_forged_is_damage(run: Path, what: str) -> None:
    """Checksums and hashes that fit do not help; the file is named."""
    forge, name = FORGERIES[what]
    forge(run)
    assert name in {problem.where.partition(":")[0] for problem in check_run(run).damage}


@pytest.mark.parametrize(
    "what", ["a result", "the last note removed", "the manifest", "two pictures swapped"]
)
def test_a_chain_that_was_written_anew_is_seen_by_a_root_kept_elsewhere(run: Path, what: str) -> None:
    """Then a check finds nothing, but the hash that was noted of the newest link is gone."""
    newest = check_run(run).links[-1].sha256
    FORGERIES[what][0](run)
    redo_hashes(run)
    redo_chain(run)
    checked = check_run(run)
    assert (checked.damage, checked.seal) == ((), "sealed")
    assert find_link(checked.links, newest) is None


def test_an_edited_result_is_used_by_nothing(run: Path) -> None:
    """Who reads it is refused with its name; the list of runs that searches for it calls the run damaged."""
    (found,) = find_runs(run.parent, "mean_radius_mm=27.5")
    assert found.summary.exit_status == "success"
    _edit_result(run)
    with pytest.raises(RecordError, match=r"analysis/001/result\.json: it was changed"):
        open_run(run).latest_result()
    with pytest.raises(RecordError, match=r"analysis/001/result\.json: it was changed"):
        open_run(run).result_dir(1)
    assert list_runs(run.parent)[0].exit_status == "damaged"
    (found,) = find_runs(run.parent, sort="exit_status")
    assert (found.summary.exit_status, found.fields["exit_status"]) == ("damaged", ("damaged",))
    with pytest.raises(InputError, match="no run has a field 'mean_radius_mm'"):
        find_runs(run.parent, "mean_radius_mm=99.9")


def test_what_no_link_covers_is_named_and_not_used(run: Path) -> None:
    """A result, a note or a calibration that somebody put there changes nothing; a file beside the record may stay."""
    (run / "analysis/002").mkdir()
    (run / "analysis/002/result.json").write_bytes(RESULT.replace(b"27.5", b"99.9"))
    with (run / "notes.jsonl").open("ab") as notes:
        notes.write(
            encode_line({"kind": "verdict", "verdict": "good", "reason": "", "by": "Yang", "at": ENDED})
        )
    (run / "photo.jpg").write_bytes(b"of the bench")
    (run / "calibration/.DS_Store").write_bytes(b"of a Mac")
    _add_mask(run)
    checked = check_run(run)
    assert [problem.where for problem in checked.damage] == ["calibration/mask.json"]
    assert [problem.where for problem in checked.notices] == [
        "notes.jsonl", "analysis/002", "photo.jpg", "calibration/.DS_Store",
    ]  # fmt: skip
    opened = open_run(run)
    assert [problem.where for problem in opened.problems] == ["notes.jsonl", "analysis/002"]
    assert opened.damage == ()
    assert (opened.latest_result(), opened.result_numbers) == ({"mean_radius_mm": 27.5}, (1,))
    assert opened.annotations.verdict == "bad"
    assert opened.calibration_files == ("intrinsics.json", "plane.json")
    with pytest.raises(RecordError, match=r"mask\.json is no part of the record"):
        opened.calibration_path("mask.json")


def test_a_file_that_was_added_to_a_result_ends_its_use(run: Path) -> None:
    """A page would draw centre lines that somebody put there; the file is named instead."""
    (run / "analysis/001/centre_lines.npz").write_bytes(b"added")
    assert "analysis/001/centre_lines.npz" in {problem.where for problem in check_run(run).damage}
    with pytest.raises(RecordError, match=r"centre_lines\.npz is no part of that result"):
        open_run(run).result_dir(1)


def test_what_stands_without_a_link_is_taken_in_by_repair(run: Path) -> None:
    """A process killed between file and link leaves the run unsealed, not damaged; nobody adds to it until then."""
    complete = (run / "chain.jsonl").read_bytes()
    note_on_run(run, "third", revises=None, by="Chen", at=ENDED)
    add_result(run, RESULT.replace(b"27.5", b"28.5"))
    (run / "chain.jsonl").write_bytes(complete)
    before = check_run(run)
    assert (before.damage, before.seal, len(before.notices)) == ((), "unsealed", 2)
    with pytest.raises(RecordError, match="1 lines without a link"):
        note_on_run(run, "fourth", revises=None, by="Chen", at=ENDED)
    assert repair_run(run, ENDED)
    after = check_run(run)
    assert (after.damage, after.seal, after.links[-1].kind) == ((), "unsealed", "unsealed")
    assert len(note_on_run(run, "fourth", revises=None, by="Chen", at=ENDED).notes) == 4
    assert open_run(run).latest_result() == {"mean_radius_mm": 28.5}
    assert not repair_run(run, ENDED)


def test_a_closing_that_was_stopped_after_its_link_is_finished(tmp_path: Path) -> None:
    """The manifest is put into place as it was meant; nothing is closed twice."""
    run = closed_run(tmp_path)
    closed = (run / "manifest.json").read_bytes()
    interrupted = begin(tmp_path / "other")
    opening = json.loads((interrupted.path / "manifest.json").read_bytes())
    (run / "manifest.json").replace(run / ".manifest.closing")
    (run / "manifest.json").write_bytes((interrupted.path / "manifest.json").read_bytes())
    assert opening["exit_status"] == "incomplete"
    assert (check_run(run).damage, check_run(run).seal) == ((), "unsealed")
    assert repair_run(run, ENDED)
    assert (run / "manifest.json").read_bytes() == closed
    assert (check_run(run).damage, check_run(run).seal) == ((), "sealed")


def test_a_torn_link_is_named_and_overwritten(run: Path) -> None:
    """It was never acknowledged; the next link continues the last whole one."""
    whole = (run / "chain.jsonl").read_bytes()
    for torn in (b'{"link":8,"kind":"no', whole.splitlines()[-1][:-1]):
        (run / "chain.jsonl").write_bytes(whole + torn)
        assert "chain.jsonl" in named(run)
        assert check_run(run).damage == ()
    append_link(run, "note", ENDED, {})
    assert scan_chain(run).damaged == scan_chain(run).torn == ()
    (run / "chain.jsonl").write_bytes(whole[:-1])
    append_link(run, "note", ENDED, {})
    assert [link.kind for link in scan_chain(run).links][-2:] == ["note", "note"]
    assert scan_chain(run).damaged == ()


def test_a_run_that_went_on_is_closed_by_a_second_link(tmp_path: Path) -> None:
    """Both roots are in its chain, the closed manifest of the first is kept, and its raw files only grew."""
    recorder = begin(tmp_path)
    fill(recorder)
    recorder.close("failed", "no needle", ENDED)
    run, first = recorder.path, find_root(recorder.path)
    reopened = Recorder.reopen(run, "test")
    assert (check_run(run).damage, check_run(run).seal) == ((), "open")
    reopened.frame(picture(9), 1.0)
    reopened.close("success", "", ENDED)
    checked = check_run(run)
    assert (checked.damage, checked.notices, checked.seal) == ((), (), "sealed")
    assert [link.kind for link in checked.links] == ["open", "close", "open", "close"]
    assert first == checked.links[1].sha256 != find_root(run)
    assert json.loads((run / "manifest.001.json").read_bytes())["exit_status"] == "failed"
    edit_line(run / "states.jsonl", 1, insertion_mm=9.0)
    redo_hashes(run)
    assert "states.jsonl" in {problem.where for problem in check_run(run).damage}


def test_a_record_without_a_chain_is_unsealed_and_never_gets_one(tmp_path: Path) -> None:
    """It is sound, its results and notes are used without a link, and an extra calibration is named and not used."""
    run = without_chain(closed_run(tmp_path))
    add_result(run, RESULT)
    note_on_run(run, "first", revises=None, by="Chen", at=ENDED)
    checked = check_run(run)
    assert (checked.damage, checked.notices, checked.seal) == ((), (), "unsealed (made before)")
    assert (find_root(run), (run / "chain.jsonl").exists()) == (None, False)
    assert open_run(run).latest_result() == {"mean_radius_mm": 27.5}
    assert len(read_annotations(run).notes) == 1
    _add_mask(run)
    checked = check_run(run)
    assert (checked.damage, [problem.where for problem in checked.notices]) == ((), ["calibration/mask.json"])
    assert "mask.json" not in open_run(run).calibration_files


def test_a_record_without_a_chain_that_goes_on_is_sealed_from_then_on(tmp_path: Path) -> None:
    """Its first link covers the results and notes that it had."""
    recorder = begin(tmp_path)
    fill(recorder)
    recorder.close("failed", "", ENDED)
    run = without_chain(recorder.path)
    add_result(run, RESULT)
    note_on_run(run, "first", revises=None, by="Chen", at=ENDED)
    Recorder.reopen(run, "test").close("success", "", ENDED)
    checked = check_run(run)
    assert (checked.damage, checked.notices, checked.seal) == ((), (), "sealed")
    assert [link.kind for link in checked.links] == ["open", "close"]
    assert open_run(run).latest_result() == {"mean_radius_mm": 27.5}
    assert len(read_annotations(run).notes) == 1
    _edit_result(run)
    assert "analysis/001/result.json" in named(run)


def _append_links(run: Path) -> None:
    for number in range(20):
        append_link(run, "note", None, {f"{os.getpid()}-{number}": ""})


def test_two_processes_do_not_fork_the_chain(tmp_path: Path) -> None:
    """Links that are appended at once stand one after another, and each continues the one before."""
    run = closed_run(tmp_path)
    processes = [
        multiprocessing.get_context("fork").Process(target=_append_links, args=(run,)) for _ in range(3)
    ]
    for process in processes:
        process.start()
    for process in processes:
        process.join()
    scan = scan_chain(run)
    assert (scan.damaged, len(scan.links)) == ((), 2 + 60)


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_any_changed_byte_of_any_file_is_named(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    """Whatever file of a closed run with results, page and notes is changed, cut or removed, a check names it."""
    run = _kept_run(tmp_path_factory)
    files = sorted(path for path in run.rglob("*") if path.is_file() and not path.name.startswith("."))
    path = data.draw(st.sampled_from(files))
    content = path.read_bytes()
    place = data.draw(st.integers(0, len(content) - 1))
    changed = data.draw(
        st.sampled_from(
            [
                content[:place] + bytes([content[place] ^ 1 << place % 8]) + content[place + 1 :],
                content[:place],
                content[:place] + b"x" + content[place:],
            ]
        )
    )
    try:
        path.write_bytes(changed)
        name = path.relative_to(run).as_posix()
        assert name in told_of(run)
        path.unlink()
        assert name in told_of(run)
    finally:
        path.write_bytes(content)


def told_of(run: Path) -> str:
    """Return all that a check says, be it by refusing."""
    try:
        checked = check_run(run)
    except RecordError as error:
        return error.message
    return "\n".join(f"{problem.where}: {problem.message}" for problem in (*checked.damage, *checked.notices))


_KEPT: dict[str, Path] = {}


def _kept_run(factory: pytest.TempPathFactory) -> Path:
    """Return one run for all examples; each of them leaves it as it was."""
    if "run" not in _KEPT:
        run = full_run(factory.mktemp("sealed"), closed=True)
        add_result(run, RESULT)
        note_on_run(run, "first", revises=None, by="Chen", at=ENDED)
        (run / "report.html").write_text("<html></html>")
        open_run(run).seal_page(run / "report.html", ENDED)
        assert describe_damage(run) == ""
        _KEPT["run"] = run
    return _KEPT["run"]
