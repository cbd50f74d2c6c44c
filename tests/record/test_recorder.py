"""Writing a run."""

import hashlib
import json
import subprocess
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.errors import DiskError, InputError, OutputExistsError, RecordError
from labrig.record.catalogue import list_runs
from labrig.record.check import check_run
from labrig.record.reader import open_run
from labrig.record.reopen import reopen_run
from labrig.record.writer import Recorder, RunFiles, create_under_free_name
from tests.record.runs import ENDED, PROTOCOL_YAML, STARTED, begin, closed_run, fill, picture


def test_the_layout_is_there_from_the_start(tmp_path: Path) -> None:
    """Before anything moves, the run says what it is, of what it is made, and that it is incomplete."""
    recorder = begin(
        tmp_path, operator="ß", devices={"camera": {"gain": np.float64(1)}}, provenance={"host": "h"}
    )
    names = {str(path.relative_to(recorder.path)) for path in recorder.path.rglob("*") if path.is_file()}
    assert names == {
        ".lock", ".lock.owner", ".reserve", "manifest.json", "protocol.yaml", "rig.yaml", "SHA256SUMS",
        "calibration/intrinsics.json", "calibration/plane.json",
        "frames.jsonl", "states.jsonl", "events.jsonl", "devices.jsonl",
    }  # fmt: skip
    manifest = json.loads((recorder.path / "manifest.json").read_text())
    assert manifest["exit_status"] == "incomplete"
    assert (manifest["run"], manifest["schema_version"]) == ("run", 1)
    assert (manifest["started"], manifest["ended"]) == ("2026-03-02T09:30:00+00:00", None)
    assert (manifest["title"], manifest["operator"], manifest["trials_planned"]) == ("Größe", "ß", 3)
    run = open_run(recorder.path)
    assert run.hashes["protocol.yaml"] == hashlib.sha256(PROTOCOL_YAML.encode()).hexdigest()
    assert run.calibration_files == ("intrinsics.json", "plane.json")
    assert manifest["recording"] == {
        "fsync_period_s": 1.0,
        "least_free_bytes": 0,
        "picture_store": "png",
    }
    assert run.devices == {"camera": {"gain": 1.0}}


def test_the_difference_of_the_code_is_kept_and_hashed(tmp_path: Path) -> None:
    """code.diff stands from the start, under the manifest's hash; a change of it is damage."""
    recorder = Recorder.create(
        tmp_path, "run", {"experiment": "import", "started": STARTED}, RunFiles("{}", code_diff=b"+1\n")
    )
    assert (recorder.path / "code.diff").read_bytes() == b"+1\n"
    assert open_run(recorder.path).damage == ()
    recorder.close("success", "", ENDED)
    (recorder.path / "code.diff").write_bytes(b"+2\n")
    assert [problem.where for problem in open_run(recorder.path).damage] == ["code.diff"]


def test_closing_says_how_it_ended(tmp_path: Path) -> None:
    """The closed manifest holds the outcome and keeps all that it held before."""
    manifest = json.loads((closed_run(tmp_path) / "manifest.json").read_text())
    assert (manifest["exit_status"], manifest["reason"]) == ("success", "")
    assert manifest["summary"] == {"trials_done": 2, "pictures": 4}
    assert manifest["ended"] == "2026-03-02T09:45:00+00:00"
    assert manifest["title"] == "Größe"


def test_trials_that_are_not_evaluated_are_not_done(tmp_path: Path) -> None:
    """A trial made again or marked as bad is not counted, before a run is closed, after, and once it is resumed."""
    recorder = begin(tmp_path)
    fill(recorder, trials=5)
    recorder.event("repeat", 60.0, trial=0)
    recorder.event("mark_bad", 61.0, trial=1, reason="it slipped")
    recorder.event("repeat", 62.0, trial=2)
    recorder.event("undo", 63.0, undone="repeat")
    assert [summary.trials_done for summary in list_runs(tmp_path)] == [3]
    recorder.close("aborted", "", ENDED)
    assert open_run(recorder.path).manifest["summary"] == {"trials_done": 3, "pictures": 10}
    assert check_run(recorder.path).trials_done == 3
    again = reopen_run(recorder.path, "labrig resume")
    again.event("repeat", 1.0, trial=4)
    again.close("success", "", ENDED)
    assert [summary.trials_done for summary in list_runs(tmp_path)] == [2]


def test_the_sums_are_those_of_sha256sum(tmp_path: Path) -> None:
    """`sha256sum -c` accepts SHA256SUMS, and it covers everything that was recorded."""
    run = closed_run(tmp_path)
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=run, check=True)
    listed = {line.split("  ")[1] for line in (run / "SHA256SUMS").read_text().splitlines()}
    present = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    assert listed == present - {"SHA256SUMS", ".lock"}


def test_equal_calls_give_equal_bytes(tmp_path: Path) -> None:
    """Two runs of the same calls hold the same bytes, whatever their folders."""
    first, second = closed_run(tmp_path / "a", "one"), closed_run(tmp_path / "b", "one")
    assert (first / "SHA256SUMS").read_bytes() == (second / "SHA256SUMS").read_bytes()


def test_closing_twice_is_closing_once(tmp_path: Path) -> None:
    """The first outcome stands; nothing can be added to a closed run."""
    recorder = begin(tmp_path)
    recorder.close("aborted", "SIGINT", ENDED)
    recorder.close("success", "", ENDED)
    assert open_run(recorder.path).manifest["exit_status"] == "aborted"
    for adding in (
        lambda: recorder.state(1.0),
        lambda: recorder.frame(picture(0), 1.0),
        lambda: recorder.truth(trial=0),
    ):
        with pytest.raises(RecordError, match="is closed"):
            adding()
    assert not any((recorder.path / "frames").iterdir())


def test_an_unknown_outcome_is_refused(tmp_path: Path) -> None:
    """Only the three documented outcomes close a run; a refused one leaves it open."""
    recorder = begin(tmp_path)
    with pytest.raises(InputError, match="done"):
        recorder.close("done", "", ENDED)
    recorder.state(0.0)


def test_an_existing_folder_is_left_alone(tmp_path: Path) -> None:
    """A name that is taken, even by an empty folder, is refused and nothing of it changes."""
    (tmp_path / "run").mkdir()
    with pytest.raises(OutputExistsError, match="run exists already"):
        begin(tmp_path)
    assert not any((tmp_path / "run").iterdir())


def test_runs_that_start_in_the_same_second_get_a_name_each(tmp_path: Path) -> None:
    """Of runs that begin at once none fails, and none is given the folder of another."""
    with ThreadPoolExecutor(8) as pool:
        begun = [
            pool.submit(create_under_free_name, STARTED, "sweep", partial(begin, tmp_path)) for _ in range(16)
        ]
        recorders = [start.result() for start in begun]
    endings = ["", *(f"-{number}" for number in range(2, 17))]
    assert {recorder.run_name for recorder in recorders} == {f"20260302-093000-sweep{end}" for end in endings}
    for recorder in recorders:
        recorder.close("success", "", ENDED)


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a/b", "a\\b", "../run", ".hidden", "a\nb", "a\x00b", " a", "a" * 201]
)
def test_a_name_that_is_no_folder_name_is_refused(tmp_path: Path, name: str) -> None:
    """Separators, dots in front, control characters and long names are refused before anything is made."""
    with pytest.raises(InputError, match="the run name"):
        begin(tmp_path / "runs", name)
    assert not (tmp_path / "runs").exists()


def test_a_name_may_have_blanks_and_letters_of_any_language(tmp_path: Path) -> None:
    """Names are for people."""
    path = closed_run(tmp_path, "Gel 13 % – éprouvette №2")
    assert open_run(path).damage == ()


@pytest.mark.parametrize(
    "image",
    [
        np.zeros((4, 4), np.uint16), np.zeros((4, 4), np.float64), np.zeros((4, 4, 4), np.uint8),
        np.zeros((0, 4), np.uint8), np.zeros(4, np.uint8),
    ],
)  # fmt: skip
def test_only_pictures_are_recorded(tmp_path: Path, image: np.ndarray) -> None:
    """An array that is no 8-bit grey or BGR picture is refused with its type and shape."""
    with pytest.raises(InputError, match="a picture is a uint8 array"):
        begin(tmp_path).frame(image, 0.0)


def test_pictures_are_lossless(tmp_path: Path) -> None:
    """Grey and BGR pictures, also views with strides of their own, come back pixel for pixel."""
    recorder = begin(tmp_path)
    images = [picture(0), picture(1, (24, 32, 3)), picture(2, (24, 32, 3))[:, ::-1], picture(3).T]
    assert [recorder.frame(image, 0.0) for image in images] == [0, 1, 2, 3]
    for read, image in zip(open_run(recorder.path).pictures, images, strict=True):
        np.testing.assert_array_equal(read, image)


def test_a_line_of_a_picture_comes_after_its_file(tmp_path: Path) -> None:
    """The line names the file and its hash, and any reader of PNG finds the picture."""
    recorder = begin(tmp_path)
    recorder.frame(picture(5), 2.5, trial=0, role="final", rotation_rad=float("nan"))
    (line,) = map(json.loads, (recorder.path / "frames.jsonl").read_text().splitlines())
    assert (line["frame"], line["file"], line["t_s"], line["rotation_rad"]) == (
        0,
        "frames/000000.png",
        2.5,
        None,
    )
    content = (recorder.path / line["file"]).read_bytes()
    assert hashlib.sha256(content).hexdigest() == line["sha256"]
    np.testing.assert_array_equal(
        cv2.imread(str(recorder.path / line["file"]), cv2.IMREAD_UNCHANGED), picture(5)
    )


@pytest.mark.parametrize("name", ["file", "sha256", "frame"])
def test_a_field_cannot_pose_as_the_recorders_own(tmp_path: Path, name: str) -> None:
    """A field of a picture's line that the recorder writes itself is refused."""
    with pytest.raises(InputError, match=name):
        begin(tmp_path).frame(picture(0), 0.0, **{name: "x"})


def test_time_is_a_number(tmp_path: Path) -> None:
    """A line without a finite rig time is refused."""
    with pytest.raises(InputError, match="nan"):
        begin(tmp_path).state(float("nan"))


@pytest.mark.parametrize("period_s", [0.0, -1.0, float("inf")])
def test_the_fsync_period_is_a_duration(tmp_path: Path, period_s: float) -> None:
    """A period that would never or always end is refused."""
    with pytest.raises(InputError, match="fsync_period_s"):
        Recorder.create(
            tmp_path, "run", {"experiment": "x", "started": STARTED}, RunFiles(""), fsync_period_s=period_s
        )


def test_a_manifest_says_at_least_what_and_when(tmp_path: Path) -> None:
    """A run without experiment and start is refused before its folder is made."""
    with pytest.raises(InputError, match="experiment and started"):
        Recorder.create(tmp_path, "run", {}, RunFiles(""))
    assert not any(tmp_path.iterdir())


def test_a_manifest_that_json_cannot_say_leaves_nothing_behind(tmp_path: Path) -> None:
    """What cannot be written is found before the folder is made, so the name stays free."""
    with pytest.raises(InputError, match="axes"):
        begin(tmp_path, devices={"axes": {1, 2}})
    assert not any(tmp_path.iterdir())


def test_calibration_files_are_copied(tmp_path: Path) -> None:
    """A calibration given by its path is copied, so that the original may change."""
    source = tmp_path / "plane-of-march.json"
    source.write_bytes(b"before")
    recorder = Recorder.create(
        tmp_path,
        "run",
        {"experiment": "x", "started": STARTED},
        RunFiles("", calibration={"plane.json": source}),
    )
    source.write_bytes(b"after")
    assert open_run(recorder.path).calibration_path("plane.json").read_bytes() == b"before"


def test_a_missing_calibration_file_is_named(tmp_path: Path) -> None:
    """A calibration that is not there is refused before the folder is made."""
    with pytest.raises(InputError, match=r"plane\.json.*No such file"):
        Recorder.create(
            tmp_path,
            "run",
            {"experiment": "x", "started": STARTED},
            RunFiles("", calibration={"plane.json": tmp_path / "plane.json"}),
        )
    assert not any(tmp_path.iterdir())


def test_a_file_in_the_place_of_the_runs_folder_is_named(tmp_path: Path) -> None:
    """A runs folder that is a file gives a disk error that says so."""
    (tmp_path / "runs").write_text("")
    with pytest.raises(DiskError, match="runs"):
        begin(tmp_path / "runs")


def test_the_run_without_a_world_has_no_truth(tmp_path: Path) -> None:
    """truth.jsonl is made with its first line, so a real rig has none."""
    recorder = begin(tmp_path)
    assert not (recorder.path / "truth.jsonl").exists()
    fill(recorder)
    assert (recorder.path / "truth.jsonl").exists()


def test_a_fast_camera_has_its_pictures_as_pgm_and_ppm(tmp_path: Path) -> None:
    """Plain files that any viewer opens; in colour PPM."""
    recorder = begin(tmp_path, store="pgm")
    images = [picture(0), picture(1, (24, 32, 3))]
    for image in images:
        recorder.frame(image, 0.0)
    run = open_run(recorder.path)
    assert [line.file for line in run.frame_lines] == ["frames/000000.pgm", "frames/000001.ppm"]
    assert (recorder.path / "frames/000000.pgm").read_bytes().endswith(images[0].tobytes())
    for read, image in zip(run.pictures, images, strict=True):
        np.testing.assert_array_equal(read, image)


def test_a_list_reads_little_of_a_run(tmp_path: Path) -> None:
    """A manifest stays below 4 kB with everything but the protocol and the command line."""
    path = closed_run(tmp_path, devices={"axes": ["of many words"] * 1000})
    assert (path / "manifest.json").stat().st_size < 1000
