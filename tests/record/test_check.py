"""Checking and repairing a record."""

import random
import shutil
from collections.abc import Callable
from pathlib import Path

import pytest

from labrig.errors import LockedError, RecordError
from labrig.record.check import RunCheck, check_run
from labrig.record.json_lines import decode_line, encode_line
from labrig.record.lock import FileLock
from labrig.record.pictures import Store
from labrig.record.reader import open_run
from labrig.record.repair import repair_run
from labrig.record.writer import Recorder
from tests.record.faults import (
    RAW_FILES,
    describe_damage,
    full_run,
    is_noticed_or_unchanged,
    killed_run,
    values,
)
from tests.record.runs import ENDED, begin, closed_run, picture


def edit_line(path: Path, number: int, **changes: object) -> None:
    """Change a line and give it a checksum that fits."""
    lines = path.read_bytes().splitlines()
    lines[number - 1] = encode_line(decode_line(lines[number - 1]) | changes).rstrip(b"\n")
    path.write_bytes(b"\n".join(lines) + b"\n")


def places(verdict: RunCheck) -> list[str]:
    """Return the places of the damage."""
    return [problem.where for problem in verdict.damage]


def test_a_line_of_can_log_that_is_no_frame_is_named(tmp_path: Path) -> None:
    """Its number is told also where no checksum speaks against it, as in the log of an early labrig."""
    run = full_run(tmp_path, closed=False)
    (run / "can.sums.jsonl").unlink()
    lines = (run / "can.log").read_bytes().splitlines(keepends=True)
    (run / "can.log").write_bytes(b"".join([*lines, b"(22.000000) can 601#1 T\n", *lines]))
    (message,) = (problem.message for problem in check_run(run).damage if problem.where == "can.log")
    assert message == f"can.log:{len(lines) + 1}: the line is no CAN frame"


@pytest.mark.parametrize("closed", [True, False])
def test_an_intact_run_has_nothing_wrong(tmp_path: Path, closed: bool) -> None:
    """A closed and a killed run that lost nothing are sound, and their contents are counted."""
    verdict = check_run(full_run(tmp_path, closed=closed))
    assert (verdict.damage, verdict.torn, verdict.writer) == ((), (), None)
    assert (verdict.frames, verdict.states, verdict.events, verdict.trials_done) == (4, 6, 6, 2)


def test_every_changed_file_of_a_closed_run_is_found(tmp_path: Path) -> None:
    """One flipped bit anywhere is named with its file."""
    run = full_run(tmp_path, closed=True)
    for name in RAW_FILES:
        content = (run / name).read_bytes()
        (run / name).write_bytes(content[:-3] + bytes([content[-3] ^ 1]) + content[-2:])
        assert name in describe_damage(run), name
        (run / name).write_bytes(content)
    assert check_run(run).damage == ()


@pytest.mark.parametrize(
    ("name", "number", "changes", "words"),
    [
        ("frames.jsonl", 3, {"frame": 1}, "frame 1 is there twice"),
        ("frames.jsonl", 3, {"frame": 5, "file": "frames/000005.png"}, "frames 2 to 4 are missing"),
        ("frames.jsonl", 3, {"frame": "2"}, "frame is '2', expected 2"),
        ("frames.jsonl", 3, {"file": "../../precious.png"}, "expected 'frames/000002.png'"),
        ("frames.jsonl", 3, {"trial": 9}, "it is of trial 9, which never began"),
        ("states.jsonl", 4, {"t_s": 0.5}, "the clock goes backwards: t_s is 0.5 s after 2 s"),
        ("states.jsonl", 4, {"t_s": None}, "t_s is None, expected a time"),
        ("events.jsonl", 4, {"trial": 0}, "trial 0 begins a second time"),
        ("events.jsonl", 4, {"trial": [0]}, "trial 1 ends without having begun"),
        ("events.jsonl", 3, {"final_frame": 77}, "final_frame is 77, which is not in frames.jsonl"),
        ("events.jsonl", 3, {"final_frame": 3}, "final_frame 3 is of trial 1, the event of trial 0"),
        ("events.jsonl", 3, {"frame": 3}, "frame 3 is of trial 1, the event of trial 0"),
        ("events.jsonl", 3, {"frame": 1, "trial": None}, "frame 1 is of trial 0, the event of trial None"),
        ("frames.jsonl", 2, {"trial": None}, "final_frame 1 is of trial None, the event of trial 0"),
    ],
)  # fmt: skip
def test_lines_that_do_not_fit_together_are_named(
    tmp_path: Path, name: str, number: int, changes: dict[str, object], words: str
) -> None:
    """Duplicate numbers, missing frames, a clock that goes backwards and dangling references are named with place."""
    run = full_run(tmp_path, closed=False)
    edit_line(run / name, number, **changes)
    assert any(words in problem.message for problem in check_run(run).damage)
    with pytest.raises(RecordError, match="is damaged: "):
        Recorder.reopen(run, "test")


def test_an_event_of_a_trial_may_name_a_picture_of_none(tmp_path: Path) -> None:
    """The sheath of each hole of a roll zero is such an event: it counts holes, and its picture is of no trial."""
    run = full_run(tmp_path, closed=False)
    edit_line(run / "frames.jsonl", 1, trial=None)
    edit_line(run / "events.jsonl", 2, frame=0)
    assert check_run(run).damage == ()


def test_a_lost_picture_and_a_lost_line_are_told_apart(tmp_path: Path) -> None:
    """A deleted picture is reported as missing; a picture without its line is reported as a lost line."""
    run = full_run(tmp_path, closed=False)
    (run / "frames/000001.png").unlink()
    assert "it is missing, though frames.jsonl lists it" in [p.message for p in check_run(run).damage]
    lines = (run / "frames.jsonl").read_bytes().splitlines(keepends=True)
    (run / "frames.jsonl").write_bytes(b"".join(lines[:1]))
    assert ("frames/000002.png", "its line in frames.jsonl is lost") in [
        (p.where, p.message) for p in check_run(run).damage
    ]


@pytest.mark.parametrize("closed", [True, False], ids=["closed", "interrupted"])
@pytest.mark.parametrize(
    "name", ["notes.txt", "1.png", "0000007.png", "-00001.png", "٠٠٠٠٠٧.png", "000007.PNG"]
)
def test_a_foreign_file_among_the_pictures_is_no_lost_line(tmp_path: Path, name: str, closed: bool) -> None:
    """A file that has no name of a picture is to be moved out; one that has lacks its line."""
    run = full_run(tmp_path, closed=closed)
    for file in (name, "000007.png", "1000000.png"):
        (run / "frames" / file).write_bytes(b"")
    found = {problem.where: problem for problem in check_run(run).damage}
    foreign = found[f"frames/{name}"]
    assert "nothing lists it" in foreign.message
    assert foreign.hint == "move it out of the run"
    for file in ("frames/000007.png", "frames/1000000.png"):
        assert found[file].message == "its line in frames.jsonl is lost"


def test_a_damaged_remark_is_found(tmp_path: Path) -> None:
    """SHA256SUMS does not cover notes, but each carries its checksum; a torn last note is no damage."""
    run = full_run(tmp_path, closed=True)
    whole = encode_line({"kind": "tag", "tag": "good"})
    (run / "notes.jsonl").write_bytes(whole + whole[:-9])
    assert check_run(run).damage == ()
    (run / "notes.jsonl").write_bytes(whole.replace(b"good", b"bad!") + whole)
    assert places(check_run(run)) == ["notes.jsonl:1"]


def test_links_are_named_and_not_followed(tmp_path: Path) -> None:
    """A picture, a file of lines or a folder that is a link is damage, whatever it points to."""
    run, outside = full_run(tmp_path, closed=True), tmp_path / "outside"
    for name in ("frames/000001.png", "states.jsonl", "calibration"):
        moved = outside / name.replace("/", "-")
        outside.mkdir(exist_ok=True)
        (run / name).rename(moved)
        (run / name).symlink_to(moved)
        assert any(name in place for place in places(check_run(run)))
        (run / name).unlink()
        moved.rename(run / name)
    assert check_run(run).damage == ()


def test_what_is_no_run_or_newer_is_refused(tmp_path: Path) -> None:
    """A folder without a manifest and a run of a newer schema are named errors; neither is touched."""
    (tmp_path / "folder").mkdir()
    newer = closed_run(tmp_path, "newer")
    text = (newer / "manifest.json").read_text().replace('"schema_version": 1', '"schema_version": 99')
    (newer / "manifest.json").write_text(text)
    for path, words in ((tmp_path / "folder", "is no run"), (newer, "schema version 99")):
        before = sorted(path.rglob("*"))
        for act in (check_run, lambda p: repair_run(p, ENDED), lambda p: Recorder.reopen(p, "test")):
            with pytest.raises(RecordError, match=words):
                act(path)
        assert sorted(path.rglob("*")) == before


def test_repair_closes_a_killed_run_and_keeps_every_byte(tmp_path: Path) -> None:
    """Torn ends and the unlisted picture are set aside; everything else stays as it was; the SHA-256 sums fit."""
    run = killed_run(tmp_path)
    whole = {path: path.read_bytes() for path in run.rglob("*.jsonl") if path.name != "chain.jsonl"}
    for path, content in whole.items():
        path.write_bytes(content + b'{"torn')
    with (run / "can.log").open("ab") as log:
        log.write(b"(1.0")
    shutil.copy(run / "frames/000000.png", run / "frames/000004.png")
    (run / "frames/.000005.png.tmp").write_bytes(b"half")
    assert len(check_run(run).torn) == 8
    assert repair_run(run, ENDED)
    assert {path: path.read_bytes() for path in whole} == whole
    verdict, opened = check_run(run), open_run(run)
    assert (verdict.damage, verdict.torn, verdict.exit_status) == ((), (), "aborted")
    assert opened.problems == ()
    assert "closed by labrig runs check --repair" in str(opened.manifest["reason"])
    assert sorted(path.name for path in (run / "torn/001").iterdir()) == [
        ".000005.png.tmp", "000004.png", "can.log.end", "can.sums.jsonl.end", "events.jsonl.end",
        "frames.jsonl.end", "states.jsonl.end", "truth.jsonl.end",
    ]  # fmt: skip
    assert (run / "torn/001/states.jsonl.end").read_bytes() == b'{"torn'
    assert not repair_run(run, ENDED)


def test_repair_sets_half_written_files_aside(tmp_path: Path) -> None:
    """The temporary files of a writer that was killed are kept in torn/, out of the way of the record."""
    run = killed_run(tmp_path)
    names = {".manifest.json.0123456789abcdef.tmp", ".plane.json.0123456789abcdef.tmp"}
    (run / ".manifest.json.0123456789abcdef.tmp").write_bytes(b"half")
    (run / "calibration/.plane.json.0123456789abcdef.tmp").write_bytes(b"half")
    assert repair_run(run, ENDED)
    assert names <= {path.name for path in (run / "torn/001").iterdir()}
    assert not [path for path in run.rglob(".*.tmp") if path.parent.name != "001"]
    assert (check_run(run).damage, check_run(run).torn) == ((), ())


def test_a_run_killed_while_it_was_being_closed_keeps_its_ending(tmp_path: Path) -> None:
    """If the last event states how the run ended, repair keeps that status."""
    recorder = begin(tmp_path / "writing")
    recorder.event("run_stop", 1.0, exit_status="failed", reason="the drive is silent")
    run = Path(shutil.copytree(recorder.path, tmp_path / "run"))
    repair_run(run, ENDED)
    manifest = open_run(run).manifest
    assert (manifest["exit_status"], manifest["reason"]) == ("failed", "the drive is silent")


def test_a_damaged_run_is_not_repaired(tmp_path: Path) -> None:
    """A flipped bit in the middle is refused by repair, and nothing is changed."""
    run = killed_run(tmp_path)
    content = (run / "states.jsonl").read_bytes()
    (run / "states.jsonl").write_bytes(content[:20] + b"?" + content[21:])
    (run / ".lock").unlink()
    before = {path: path.read_bytes() for path in run.rglob("*") if path.is_file()}
    with pytest.raises(RecordError, match=r"states\.jsonl:1: the line is damaged"):
        repair_run(run, ENDED)
    assert {path: path.read_bytes() for path in run.rglob("*") if path.is_file()} == before


def test_a_run_that_is_being_written_is_left_alone(tmp_path: Path) -> None:
    """While a writer is alive, a check names it, and the run can be neither repaired nor continued."""
    run = killed_run(tmp_path)
    with FileLock(run / ".lock").acquire("labrig run"):
        owner = check_run(run).writer
        assert owner is not None
        assert owner.doing == "labrig run"
        for act in (lambda: repair_run(run, ENDED), lambda: Recorder.reopen(run, "test")):
            with pytest.raises(LockedError, match="in use by labrig run"):
                act()


def test_a_continued_run_goes_on_where_it_stopped(tmp_path: Path) -> None:
    """Numbers and rig time continue, the earlier lines stay, and the closed record is sound."""
    run = killed_run(tmp_path)
    before = (run / "events.jsonl").read_bytes()
    recorder = Recorder.reopen(run, "test")
    assert recorder.begin_session(ENDED, operator="b") == 21.0
    recorder.event("run_resume", 0.0)
    assert recorder.frame(picture(9), 0.5) == 4
    recorder.state(0.5)
    recorder.can_frames([(0.5, 0x601, b"\x01", "T")])
    recorder.close("success", "", ENDED)
    opened = open_run(run)
    assert (run / "events.jsonl").read_bytes().startswith(before)
    assert (opened.problems, check_run(run).damage) == ((), ())
    assert list(opened.events["t_s"])[-1] == 21.0
    assert list(opened.frame_table["t_s"])[-1] == 21.5
    assert [frame.t_s for frame in opened.can_frames][-1] == 21.5
    assert opened.manifest["sessions"] == [
        {"started": "2026-03-02T09:45:00+00:00", "t0_s": 21.0, "operator": "b"}
    ]
    with pytest.raises(RecordError, match="has come to its end"):
        Recorder.reopen(run, "test")


def test_each_session_keeps_the_code_that_ran(tmp_path: Path) -> None:
    """The code differences of a resumed session are stored and hashed like those of the first; a change is damage."""
    run = killed_run(tmp_path)
    (run / "code.002.diff").write_bytes(b"left by a process that was killed before its manifest named it")
    for number, diff in ((3, b"+1\n"), (4, b"+2\n")):
        recorder = Recorder.reopen(run, "test")
        recorder.begin_session(ENDED, code_diff=diff)
        recorder.close("aborted", "", ENDED)
        assert (run / f"code.{number:03d}.diff").read_bytes() == diff
    assert [session["code_diff"] for session in open_run(run).sessions] == ["code.003.diff", "code.004.diff"]
    assert "code.004.diff" in (run / "SHA256SUMS").read_text()
    assert check_run(run).damage == ()
    (run / "code.003.diff").write_bytes(b"+3\n")
    assert {problem.where for problem in check_run(run).damage} == {"code.003.diff"}
    assert [problem.where for problem in open_run(run).damage] == ["code.003.diff"]


def test_a_closed_run_that_is_continued_remembers_its_ending(tmp_path: Path) -> None:
    """The manifest keeps the earlier ending, and the earlier sums stay beside the new ones."""
    recorder = begin(tmp_path)
    recorder.close("aborted", "interrupted by INT", ENDED)
    Recorder.reopen(recorder.path, "test").close("success", "", ENDED)
    run = open_run(recorder.path)
    assert run.manifest["earlier_endings"] == [
        {"exit_status": "aborted", "reason": "interrupted by INT", "ended": "2026-03-02T09:45:00+00:00"}
    ]
    assert (run.path / "SHA256SUMS.001").is_file()
    assert check_run(run.path).damage == ()


@pytest.mark.parametrize("closed", [True, False])
@pytest.mark.parametrize("name", RAW_FILES)
def test_a_file_cut_at_any_byte_is_opened_or_refused(tmp_path: Path, name: str, closed: bool) -> None:
    """Cut at each byte of its last kilobyte (here every 83rd), a record never gives other values than before."""
    run = full_run(tmp_path, closed=closed)
    original, content = values(open_run(run)), (run / name).read_bytes()
    for kept in range(max(0, len(content) - 1024), len(content), 83):
        (run / name).write_bytes(content[:kept])
        assert is_noticed_or_unchanged(run, original), kept
        if not closed:
            describe_damage(run)


@pytest.mark.parametrize(("closed", "store"), [(True, "png"), (False, "png"), (True, "raw"), (False, "raw")])
def test_a_flipped_bit_is_noticed(tmp_path: Path, closed: bool, store: Store) -> None:
    """A flip of any bit of any file is refused with its place, reported as damage, or changes no value."""
    run = full_run(tmp_path, closed=closed, store=store)
    original = values(open_run(run))
    flip = random_flips(run, random.Random(6))
    for _ in range(30):
        path, undo = flip()
        assert is_noticed_or_unchanged(run, original), path
        describe_damage(run)
        undo()
    assert is_noticed_or_unchanged(run, original)


def random_flips(run: Path, source: random.Random) -> Callable[[], tuple[Path, Callable[[], object]]]:
    """Flip a random bit of a random file, and return the call that undoes it."""
    files = sorted(path for path in run.rglob("*") if path.is_file() and path.stat().st_size)

    def flip() -> tuple[Path, Callable[[], object]]:
        path = source.choice(files)
        content = path.read_bytes()
        changed = bytearray(content)
        changed[source.randrange(len(changed))] ^= 1 << source.randrange(8)
        path.write_bytes(changed)
        return path, lambda: path.write_bytes(content)

    return flip
