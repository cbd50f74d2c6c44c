"""Reading runs, whole and damaged."""

import json
import pickle
import random
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from labrig.errors import InputError, RecordError
from labrig.record.check import check_run
from labrig.record.json_lines import encode_document, encode_line, read_lines
from labrig.record.pictures import Store
from labrig.record.reader import Run, open_run
from labrig.record.writer import Recorder
from tests.record.faults import flip_bit
from tests.record.runs import add_result, begin, closed_run, interrupted_run, picture

RAW_FILES = [
    "manifest.json", "protocol.yaml", "rig.yaml", "calibration/intrinsics.json", "frames.jsonl",
    "states.jsonl", "events.jsonl", "truth.jsonl", "SHA256SUMS", "frames/000000.png", "frames/000003.png",
]  # fmt: skip


def everything(run: Run) -> dict[str, object]:
    """Return every value in a run."""
    tables = {name: getattr(run, name) for name in ("states", "events", "frame_table", "trials", "truth")}
    return {
        "manifest": run.manifest,
        "protocol": run.protocol,
        "calibration": run.calibration_path("intrinsics.json").read_bytes(),
        "frames": [frame.tobytes() for frame in run.frames],
        **{name: table.to_json() for name, table in tables.items()},
    }


def read_values(run_path: Path) -> dict[str, object] | None:
    """Return every value of a run that opens without a problem; None of one that is refused with a place."""
    try:
        run = open_run(run_path)
        return None if run.problems else everything(run)
    except RecordError as error:
        assert str(run_path) in error.message  # noqa: PT017 - both ends are right, silence is not
        return None


def rewrite(path: Path, row: int, **fields: object) -> None:
    """Change a line of a file and give it the right checksum, as a forger would."""
    rows = read_lines(path)
    rows[row] |= fields
    path.write_bytes(b"".join(map(encode_line, rows)))


def test_a_closed_run_gives_back_what_was_recorded(tmp_path: Path) -> None:
    """Tables, pictures, protocol and calibration come back, and there is no problem."""
    run = open_run(closed_run(tmp_path))
    assert run.problems == ()
    assert run.protocol["experiment"] == "import"
    assert list(run.states["insertion_mm"][:3]) == [0.0, 1 / 3, 2 / 3]
    assert list(run.events["kind"]) == ["run_start", *(["trial_start", "trial_stop"] * 2), "run_stop"]
    assert list(run.truth["radius_mm"]) == [27.5, 28.5]
    assert list(run.frame_table["role"]) == ["advance", "final"] * 2
    for number, frame in enumerate(run.frames):
        np.testing.assert_array_equal(frame, picture(number))
    assert run.calibration_path("intrinsics.json").read_bytes() == b'{"fx": 1.0}'


def test_trials_join_start_and_stop(tmp_path: Path) -> None:
    """One row a trial, with whole numbers whole; a trial without a stop is incomplete."""
    recorder = begin(tmp_path)
    recorder.event("trial_start", 1.0, trial=0, specimen="gel 10", hole=0)
    recorder.event("trial_stop", 9.0, trial=0, exit_status="success", final_frame=12)
    recorder.event("trial_start", 10.0, trial=1, specimen="gel 10", hole=1)
    trials = open_run(recorder.path).trials
    expected = pd.DataFrame(
        {
            "trial": pd.array([0, 1], "Int64"),
            "start_t_s": [1.0, 10.0],
            "stop_t_s": [9.0, np.nan],
            "exit_status": ["success", "incomplete"],
            "final_frame": pd.array([12, None], "Int64"),
            "specimen": ["gel 10", "gel 10"],
            "hole": [0, 1],
        }
    )
    pd.testing.assert_frame_equal(trials, expected)


def test_a_trial_begun_again_counts_once(tmp_path: Path) -> None:
    """The last start of a repeated trial counts."""
    recorder = begin(tmp_path)
    for hole in (3, 4):
        recorder.event("trial_start", float(hole), trial=0, hole=hole)
    assert list(open_run(recorder.path).trials["hole"]) == [4]


def test_an_empty_run_has_the_columns(tmp_path: Path) -> None:
    """Tables of a run that recorded nothing are empty and have the columns that code asks for."""
    run = open_run(begin(tmp_path).path)
    assert list(run.states.columns) == ["t_s"]
    assert list(run.events.columns) == ["kind", "t_s"]
    assert list(run.frame_table.columns) == ["frame", "file", "sha256", "t_s", "trial", "role"]
    assert list(run.trials.columns) == ["trial", "start_t_s", "stop_t_s", "exit_status", "final_frame"]
    assert [len(table) for table in (run.states, run.events, run.frame_table, run.trials, run.truth)] == [
        0
    ] * 5
    assert len(run.frames) == 0


def test_frames_are_a_sequence(tmp_path: Path) -> None:
    """Pictures are counted, indexed from either end and sliced without being read."""
    frames = open_run(closed_run(tmp_path)).frames
    assert len(frames) == 4
    np.testing.assert_array_equal(frames[-1], picture(3))
    assert len(frames[1::2]) == 2
    np.testing.assert_array_equal(frames[1::2][1], picture(3))
    with pytest.raises(IndexError):
        frames[4]


def test_a_run_travels_to_another_process(tmp_path: Path) -> None:
    """A run and its pictures can be pickled, so that workers can be given them."""
    run = open_run(closed_run(tmp_path))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run)).read_frame(2), picture(2))
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(run.frames))[2], picture(2))


def test_a_frame_that_is_not_there_is_named(tmp_path: Path) -> None:
    """A number beyond the record is refused with what the record holds."""
    with pytest.raises(RecordError, match="no frame 4; it holds 4"):
        open_run(closed_run(tmp_path)).read_frame(4)


def test_an_interrupted_run_opens(tmp_path: Path) -> None:
    """A run that was never closed is incomplete and gives everything that was acknowledged."""
    run = open_run(interrupted_run(tmp_path))
    assert run.problems == ()
    assert run.manifest["exit_status"] == "incomplete"
    assert (len(run.frames), len(run.trials), len(run.states)) == (4, 2, 6)


@pytest.mark.parametrize("make", [closed_run, interrupted_run])
@pytest.mark.parametrize("name", ["events.jsonl", "states.jsonl", "frames.jsonl", "truth.jsonl"])
def test_a_record_cut_at_any_byte_opens(tmp_path: Path, name: str, make: Callable[[Path], Path]) -> None:
    """Cut anywhere in its last 300 bytes, a run opens with the lines before the cut and reports the cut."""
    run_path = make(tmp_path)
    path = run_path / name
    content = path.read_bytes()
    whole = read_lines(path)
    for length in range(max(0, len(content) - 300), len(content)):
        path.write_bytes(content[:length])
        run = open_run(run_path)
        rows = read_lines(path)
        assert rows == whole[: len(rows)]
        assert len(rows) >= content[:length].count(b"\n")
        torn = content[:length].rpartition(b"\n")[2] != b"" and content[length : length + 1] != b"\n"
        assert {problem.where.split(":")[0] for problem in run.problems} <= {name}
        assert torn <= bool(run.problems)
        assert (make is closed_run) <= bool(run.problems)


def test_no_flipped_bit_goes_unnoticed(tmp_path: Path) -> None:
    """After a bit flip a run is refused with the place, has a problem, or gives the same values."""
    run_path = closed_run(tmp_path)
    before = everything(open_run(run_path))
    flips = random.Random(20)
    for _ in range(300):
        path = run_path / flips.choice(RAW_FILES)
        content = path.read_bytes()
        damaged = bytearray(content)
        bit = flips.randrange(8 * len(content))
        damaged[bit // 8] ^= 1 << bit % 8
        path.write_bytes(damaged)
        assert read_values(run_path) in (None, before), (path, bit)
        path.write_bytes(content)
    assert everything(open_run(run_path)) == before


def test_a_changed_manifest_is_reported(tmp_path: Path) -> None:
    """An edited manifest opens, and the edit is reported."""
    path = closed_run(tmp_path)
    manifest = json.loads((path / "manifest.json").read_text())
    (path / "manifest.json").write_bytes(encode_document(manifest | {"seed": 8}))
    (problem,) = open_run(path).problems
    assert problem.where == "manifest.json"


@pytest.mark.parametrize(
    ("text", "match"),
    [
        (b"{", "is damaged"),
        (b"[]", "no JSON object"),
        (b"\xff", "is damaged"),
        (b"{}", "schema_version is None"),
        (b'{"schema_version": 2}', "schema version 2; this labrig reads up to 1"),
        (b'{"schema_version": "1"}', "schema_version is '1'"),
    ],
)
def test_a_manifest_that_cannot_be_trusted_is_refused(tmp_path: Path, text: bytes, match: str) -> None:
    """A broken manifest, and one of a newer schema, are refused with their path."""
    path = closed_run(tmp_path)
    (path / "manifest.json").write_bytes(text)
    with pytest.raises(RecordError, match=match):
        open_run(path)


@pytest.mark.parametrize("name", ["nothing", "empty", "file"])
def test_a_folder_that_is_no_run_is_named(tmp_path: Path, name: str) -> None:
    """A missing folder, one without a manifest and a file are no runs."""
    (tmp_path / "empty").mkdir()
    (tmp_path / "file").write_text("")
    with pytest.raises(RecordError, match=f"{name} is no run") as refused:
        open_run(tmp_path / name)
    assert refused.value.hint


def test_a_missing_line_file_is_named(tmp_path: Path) -> None:
    """A run has its three line files from the start, so a missing one is damage."""
    path = interrupted_run(tmp_path)
    (path / "states.jsonl").unlink()
    with pytest.raises(RecordError, match=r"states\.jsonl: No such file"):
        open_run(path)


@pytest.mark.parametrize("name", ["truth.jsonl", "SHA256SUMS", "rig.yaml"])
def test_what_went_missing_later_is_reported(tmp_path: Path, name: str) -> None:
    """A closed run without one of its further files opens and says which."""
    path = closed_run(tmp_path)
    (path / name).unlink()
    assert [problem.where for problem in open_run(path).problems] == [name]


@pytest.mark.parametrize(("make", "forgiven"), [(closed_run, False), (interrupted_run, True)])
def test_a_torn_last_line_is_forgiven_only_where_the_run_was_never_closed(
    tmp_path: Path, make: Callable[[Path], Path], forgiven: bool
) -> None:
    """States cut by ten bytes are acceptable in a killed run and damage in a closed run."""
    path = make(tmp_path)
    states = path / "states.jsonl"
    states.write_bytes(states.read_bytes()[:-10])
    run = open_run(path)
    assert {problem.where.partition(":")[0] for problem in run.problems} == {"states.jsonl"}
    assert (run.damage == ()) is forgiven
    assert any("writer was stopped" in problem.hint for problem in run.problems) is forgiven


@pytest.mark.parametrize("make", [closed_run, interrupted_run])
def test_a_missing_picture_is_named(tmp_path: Path, make: Callable[[Path], Path]) -> None:
    """It is reported on opening and refused when it is read; the other pictures can be read."""
    path = make(tmp_path)
    (path / "frames" / "000001.png").unlink()
    run = open_run(path)
    assert [problem.where for problem in run.damage] == ["frames/000001.png"]
    np.testing.assert_array_equal(run.read_frame(2), picture(2))
    with pytest.raises(RecordError, match=r"000001\.png: No such file"):
        run.read_frame(1)


def test_a_changed_picture_is_refused(tmp_path: Path) -> None:
    """A valid picture that is not the recorded one is refused."""
    path = closed_run(tmp_path)
    shutil.copy(path / "frames" / "000000.png", path / "frames" / "000001.png")
    with pytest.raises(RecordError, match=r"000001\.png is damaged"):
        open_run(path).read_frame(1)


@pytest.mark.parametrize("store", ["png", "raw"])
def test_a_picture_that_changes_after_it_was_read_is_found(tmp_path: Path, store: Store) -> None:
    """What is remembered of a picture ends with its file: changed in place, it is refused and named."""
    path = closed_run(tmp_path, store=store)
    run = open_run(path, read_pictures=True)
    assert run.problems == ()
    np.testing.assert_array_equal(run.read_frame(1), picture(1))
    file = path / ("frames/000001.png" if store == "png" else "frames.raw")
    flip_bit(file)
    assert open_run(path).damage == ()
    (damage,) = open_run(path, read_pictures=True).damage
    assert (file.name in damage.where, "its SHA-256 does not fit" in damage.message) == (True, True)
    frame = 1 if store == "png" else 2
    with pytest.raises(RecordError, match=file.name):
        run.read_frame(frame)


@pytest.mark.parametrize(
    "fields", [{"file": "../secret.png"}, {"file": "/etc/passwd"}, {"frame": 0}, {"frame": None}]
)
def test_a_line_of_a_picture_cannot_lead_elsewhere(tmp_path: Path, fields: dict[str, object]) -> None:
    """A path out of the run, and a number twice, are refused with file and line."""
    path = interrupted_run(tmp_path)
    rewrite(path / "frames.jsonl", 1, **fields)
    with pytest.raises(RecordError, match=r"frames\.jsonl:2"):
        _ = open_run(path).frames


@pytest.mark.parametrize(
    "linked", ["frames/000001.png", "frames", "events.jsonl", "manifest.json", "calibration/plane.json"]
)
def test_no_link_in_a_run_is_followed(tmp_path: Path, linked: str) -> None:
    """A symbolic link in a run is refused, though it leads to the very same bytes."""
    path = closed_run(tmp_path / "runs")
    elsewhere = tmp_path / "elsewhere"
    (path / linked).rename(elsewhere)
    (path / linked).symlink_to(elsewhere)
    with pytest.raises(RecordError, match="is a symbolic link"):
        open_run(path).read_frame(1)


def test_a_linked_picture_is_damage_of_a_run_that_opens(tmp_path: Path) -> None:
    """A link among the pictures is named on opening, so that no command passes over it."""
    path = closed_run(tmp_path / "runs")
    picture_file = path / "frames" / "000001.png"
    picture_file.rename(tmp_path / "elsewhere.png")
    picture_file.symlink_to(tmp_path / "elsewhere.png")
    assert [(damage.where, damage.message) for damage in open_run(path).damage] == [
        ("frames/000001.png", "it is a symbolic link and is not followed")
    ]


def test_a_whole_number_that_is_none_is_refused(tmp_path: Path) -> None:
    """A trial that is text is refused with the file, not shown as a traceback of pandas."""
    path = interrupted_run(tmp_path)
    rewrite(path / "events.jsonl", 1, trial="one")
    with pytest.raises(RecordError, match=r"events\.jsonl: trial"):
        _ = open_run(path).trials


def test_a_changed_protocol_or_calibration_is_not_used(tmp_path: Path) -> None:
    """A file that the run began with is refused if it was changed, and the change is reported on opening."""
    path = closed_run(tmp_path)
    for name in ("protocol.yaml", "calibration/plane.json"):
        (path / name).write_text("seed: 8\n")
    run = open_run(path)
    assert [problem.where for problem in run.problems] == ["protocol.yaml", "calibration/plane.json"]
    with pytest.raises(RecordError, match="not what the run began with"):
        _ = run.protocol
    with pytest.raises(RecordError, match="not what the run began with"):
        run.calibration_path("plane.json")


def test_the_line_of_a_picture_that_is_not_there_is_refused(tmp_path: Path) -> None:
    """Events of a damaged record may name a picture whose line was cut off."""
    run = open_run(closed_run(tmp_path))
    assert run.frame_line(3).frame == 3
    with pytest.raises(RecordError, match=r"frames\.jsonl holds no frame 4; it holds 4"):
        run.frame_line(4)


def test_a_calibration_that_a_run_has_not_is_no_fault(tmp_path: Path) -> None:
    """Imported pictures have no intrinsics; their path does not exist."""
    run = open_run(closed_run(tmp_path))
    assert not run.calibration_path("undistorted.json").exists()
    with pytest.raises(InputError):
        run.calibration_path("../manifest.json")


def test_results_are_numbered_and_never_overwritten(tmp_path: Path) -> None:
    """Each analysis gets a folder of its own, even after gaps; the newest finished one is the result."""
    run = open_run(closed_run(tmp_path))
    assert run.latest_result() is None
    first, second = run.new_result_dir(), run.new_result_dir()
    assert [first.name, second.name] == ["001", "002"]
    (first / "result.json").write_bytes(encode_document({"n": 1}))
    run.seal_result(first, "2026-03-02T10:00:00+00:00")
    assert run.latest_result() == {"n": 1}
    (run.path / "analysis" / "017").mkdir()
    assert run.new_result_dir().name == "018"
    assert run.latest_result() == {"n": 1}


@pytest.mark.parametrize("text", ["{", "[]"])
def test_a_damaged_result_is_named(tmp_path: Path, text: str) -> None:
    """A result that is no JSON object is refused with its path and what to do."""
    run = open_run(closed_run(tmp_path))
    add_result(run.path, text.encode())
    with pytest.raises(RecordError, match=r"001/result\.json is damaged"):
        run.latest_result()


def test_a_run_that_is_a_link_is_not_followed(tmp_path: Path) -> None:
    """A link that leads out of the runs folder is named, whether it is read, checked or continued."""
    (tmp_path / "runs").mkdir()
    link = tmp_path / "runs" / "linked"
    link.symlink_to(closed_run(tmp_path / "elsewhere"))
    for act in (open_run, check_run, lambda path: Recorder.reopen(path, "test")):
        with pytest.raises(RecordError, match="is a symbolic link"):
            act(link)


def test_a_run_shows_itself_in_a_notebook(tmp_path: Path) -> None:
    """What it is and what is wrong with it; text of the record is escaped, and a private run names no folder."""
    recorder = begin(tmp_path, title="<script>alert(1)</script>")
    recorder.event("trial_start", 1.0, trial=0, specimen="gel 10", hole=0)
    run = open_run(recorder.path)
    shown = run._repr_html_()
    assert "&lt;script&gt;alert(1)" in shown
    assert "<script" not in shown
    assert str(tmp_path) in shown
    assert str(tmp_path) not in run.without_personal_data()._repr_html_()
    flip_bit(recorder.path / "protocol.yaml")
    assert "protocol.yaml" in open_run(recorder.path)._repr_html_()
