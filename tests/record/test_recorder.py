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
from labrig.record.layout import require_name
from labrig.record.pictures import Store
from labrig.record.reader import open_run
from labrig.record.writer import (
    Recorder,
    create_under_free_name,
    opening_files,
    reopen_run,
    require_free_name,
)
from tests.record.runs import ENDED, PROTOCOL_YAML, STARTED, begin, closed_run, fill, picture


def test_the_layout_is_there_from_the_start(tmp_path: Path) -> None:
    """Before anything moves, the run says what it is, of what it is made, and that it is incomplete."""
    devices = {"camera": {"gain": np.float64(1)}}
    recorder = begin(tmp_path, operator="ß", devices=devices, provenance={"host": "h"})
    names = {str(path.relative_to(recorder.path)) for path in recorder.path.rglob("*") if path.is_file()}
    assert names == {
        ".lock", ".lock.owner", ".reserve", "manifest.json", "protocol.yaml", "rig.yaml", "SHA256SUMS",
        "calibration/intrinsics.json", "calibration/plane.json",
        "frames.jsonl", "states.jsonl", "events.jsonl", "devices.jsonl",
    }  # fmt: skip
    manifest = json.loads((recorder.path / "manifest.json").read_text())
    assert (manifest["exit_status"], manifest["run"], manifest["schema_version"]) == ("incomplete", "run", 1)
    assert (manifest["started"], manifest["ended"]) == ("2026-03-02T09:30:00+00:00", None)
    assert (manifest["title"], manifest["operator"], manifest["trials_planned"]) == ("Größe", "ß", 3)
    run = open_run(recorder.path)
    assert run.hashes["protocol.yaml"] == hashlib.sha256(PROTOCOL_YAML.encode()).hexdigest()
    assert run.calibration_files == ("intrinsics.json", "plane.json")
    assert manifest["recording"] == {"fsync_period_s": 1.0, "least_free_bytes": 0, "picture_store": "png"}
    assert run.devices == {"camera": {"gain": 1.0}}


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
    assert check_run(recorder.path).holds["trials_done"] == 3
    again = reopen_run(recorder.path, "labrig resume")
    again.event("repeat", 1.0, trial=4)
    again.close("success", "", ENDED)
    assert [summary.trials_done for summary in list_runs(tmp_path)] == [2]


def test_the_sums_are_those_of_sha256sum(tmp_path: Path) -> None:
    """`sha256sum -c` accepts SHA256SUMS, which covers everything recorded; equal calls give equal bytes."""
    name = "Gel 13 % – éprouvette №2"
    run, other = closed_run(tmp_path / "a", name), closed_run(tmp_path / "b", name)
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=run, check=True)
    listed = {line.split("  ")[1] for line in (run / "SHA256SUMS").read_text().splitlines()}
    present = {str(path.relative_to(run)) for path in run.rglob("*") if path.is_file()}
    assert listed == present - {"SHA256SUMS", ".lock"}
    assert (run / "SHA256SUMS").read_bytes() == (other / "SHA256SUMS").read_bytes()


def test_closing_twice_is_closing_once(tmp_path: Path) -> None:
    """The first outcome stands; nothing can be added to a closed run."""
    recorder = begin(tmp_path)
    recorder.close("aborted", "SIGINT", ENDED)
    recorder.close("success", "", ENDED)
    manifest = open_run(recorder.path).manifest
    assert (manifest["exit_status"], manifest["reason"]) == ("aborted", "SIGINT")
    assert (manifest["ended"], manifest["title"]) == ("2026-03-02T09:45:00+00:00", "Größe")
    for add in (recorder.state, partial(recorder.frame, picture(0)), lambda t_s: recorder.truth(trial=0)):
        with pytest.raises(RecordError, match="is closed"):
            add(1.0)
    assert not any((recorder.path / "frames").iterdir())


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
    "name", ["", ".", "..", "a/b", "a\\b", "../run", ".hidden", "a\nb", "a\x00b", " a", 100 * "é" + "a"]
)
def test_a_name_that_is_no_folder_name_is_refused(tmp_path: Path, name: str) -> None:
    """Separators, dots in front, control characters and more than 200 bytes are refused before anything is made."""
    with pytest.raises(InputError, match="the run name"):
        begin(tmp_path / "runs", name)
    assert not (tmp_path / "runs").exists()
    assert require_name(100 * "é", "the run name") == 100 * "é"


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


@pytest.mark.parametrize(("store", "suffixes"), [("png", ["png", "png"]), ("pgm", ["pgm", "ppm"])])
def test_pictures_are_lossless(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], store: Store, suffixes: list[str]
) -> None:
    """Grey and BGR pictures, also views with strides of their own, come back pixel for pixel, by any reader."""
    recorder = begin(tmp_path, store=store)
    images = [picture(0).T, picture(1, (24, 32, 3))[:, ::-1]]
    assert [recorder.frame(image, 2.5, rotation_rad=np.nan) for image in images] == [0, 1]
    lines = open_run(recorder.path).lines("frames")
    assert [line["file"] for line in lines] == [f"frames/{n:06d}.{end}" for n, end in enumerate(suffixes)]
    assert (lines[1]["t_s"], lines[1]["rotation_rad"]) == (2.5, None)
    for read, image, line in zip(open_run(recorder.path).pictures, images, lines, strict=True):
        np.testing.assert_array_equal(read, image)
        file = recorder.path / line["file"]
        np.testing.assert_array_equal(cv2.imread(str(file), cv2.IMREAD_UNCHANGED), image)
        assert hashlib.sha256(file.read_bytes()).hexdigest() == line["sha256"]
    assert capfd.readouterr().err == ""  # OpenCV warns of settings that are those of another kind of file


def test_what_cannot_be_begun_or_written_is_refused(tmp_path: Path) -> None:
    """With its name; a taken folder is left alone, and a run that cannot be begun leaves nothing behind."""
    (tmp_path / "taken").mkdir()
    (tmp_path / "file").write_text("")
    for begin_named in (begin, require_free_name):
        with pytest.raises(OutputExistsError, match="taken exists already"):
            begin_named(tmp_path, "taken")
    require_free_name(tmp_path, "free")
    with pytest.raises(DiskError, match="file"):
        begin(tmp_path / "file")
    with pytest.raises(InputError, match="axes"):
        begin(tmp_path, devices={"axes": object()})
    with pytest.raises(InputError, match=r"plane\.json.*No such file"):
        opening_files("", calibration={"plane.json": tmp_path / "plane.json"})
    assert sorted(path.name for path in tmp_path.rglob("*")) == ["file", "taken"]
    recorder = begin(tmp_path)
    with pytest.raises(InputError, match="nan"):
        recorder.state(float("nan"))
    with pytest.raises(InputError, match="done"):
        recorder.close("done", "", ENDED)
    recorder.state(0.0)


def test_calibration_and_changes_of_the_code_are_kept(tmp_path: Path) -> None:
    """They are copies, which SHA256SUMS covers from the start."""
    source = tmp_path / "plane-of-march.json"
    source.write_bytes(b"before")
    files = opening_files("{}", calibration={"plane.json": source}, code_diff=b"+1\n")
    recorder = Recorder.create(tmp_path, "run", {"experiment": "import", "started": STARTED}, files)
    source.write_bytes(b"after")
    assert open_run(recorder.path).calibration_path("plane.json").read_bytes() == b"before"
    (recorder.path / "code.diff").write_bytes(b"+2\n")
    assert [problem.where for problem in open_run(recorder.path).damage] == ["code.diff"]
