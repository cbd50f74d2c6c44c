"""Pictures in frames.raw: for cameras too fast for PNG."""

import json
import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from labrig.errors import RecordError
from labrig.record.check import check_run
from labrig.record.json_lines import encode_line
from labrig.record.reader import open_run
from labrig.record.repair import repair_run
from labrig.record.writer import Recorder
from tests.record.runs import ENDED, begin, closed_run, interrupted_run, picture


def _killed_run(runs_dir: Path) -> Path:
    """Return a copy of an unfinished run, which no process holds."""
    return Path(shutil.copytree(interrupted_run(runs_dir / "writing", store="raw"), runs_dir / "run"))


def test_raw_pictures_come_back_pixel_for_pixel(tmp_path: Path) -> None:
    """Grey and BGR pictures of several sizes stand one after another and are read back each for itself."""
    recorder = begin(tmp_path, store="raw")
    images = [picture(0), picture(1, (24, 32, 3)), picture(2, (7, 5))[:, ::-1], picture(3).T]
    for number, image in enumerate(images):
        recorder.frame(image, float(number))
    recorder.close("success", "", ENDED)
    run = open_run(recorder.path)
    assert run.problems == ()
    for read, image in zip(run.frames, images, strict=True):
        np.testing.assert_array_equal(read, image)
    np.testing.assert_array_equal(run.frames[1:][0], images[1])
    assert not any((recorder.path / "frames").iterdir())


def test_sums_cover_the_raw_file(tmp_path: Path) -> None:
    """`sha256sum -c` accepts a closed run with raw pictures, and the check of labrig finds nothing."""
    run = closed_run(tmp_path, store="raw")
    assert "  frames.raw\n" in (run / "SHA256SUMS").read_text()
    subprocess.run(["sha256sum", "--check", "--strict", "--quiet", "SHA256SUMS"], cwd=run, check=True)
    assert check_run(run).damage == ()


def test_a_flipped_bit_is_told_with_its_picture(tmp_path: Path) -> None:
    """Of raw pictures one is damaged, the others are read."""
    run = closed_run(tmp_path, store="raw")
    content = bytearray((run / "frames.raw").read_bytes())
    content[24 * 32 + 5] ^= 1
    (run / "frames.raw").write_bytes(content)
    frames = open_run(run).frames
    np.testing.assert_array_equal(frames[0], picture(0))
    with pytest.raises(RecordError, match=r"frames\.raw from byte 768 is damaged"):
        frames[1]
    assert any("frame 1" in problem.where for problem in check_run(run).damage)


def test_a_raw_file_that_was_cut_is_damage(tmp_path: Path) -> None:
    """Bytes that lines speak of and that are gone are counted."""
    run = _killed_run(tmp_path)
    os.truncate(run / "frames.raw", 3 * 24 * 32 + 1)
    (problem,) = open_run(run).damage
    assert (problem.where, "767 bytes are missing" in problem.message) == ("frames.raw", True)


def test_a_picture_without_a_line_is_set_aside(tmp_path: Path) -> None:
    """What a killed writer left behind the last acknowledged picture is kept apart, and the run goes on behind it."""
    run = _killed_run(tmp_path)
    whole = (run / "frames.raw").read_bytes()
    (run / "frames.raw").write_bytes(whole + b"torn")
    assert [problem.where for problem in check_run(run).torn] == ["frames.raw"]
    assert open_run(run).damage == ()
    recorder = Recorder.reopen(run, "a test")
    recorder.frame(picture(9), 1.0, trial=None)
    recorder.close("success", "", ENDED)
    assert (run / "torn" / "001" / "frames.raw.end").read_bytes() == b"torn"
    assert (run / "frames.raw").read_bytes() == whole + picture(9).tobytes()
    np.testing.assert_array_equal(open_run(run).frames[4], picture(9))
    assert check_run(run).damage == ()


def test_an_interrupted_run_with_raw_pictures_is_closed(tmp_path: Path) -> None:
    """Repairing closes it, sums included."""
    run = _killed_run(tmp_path)
    assert repair_run(run, ENDED)
    assert open_run(run).problems == ()


@pytest.mark.parametrize(
    "place",
    [
        {"file": "../frames.raw"},
        {"offset": -1},
        {"shape": [24]},
        {"shape": [0, 3]},
        {"shape": "24"},
        {"offset": None},
    ],
)
def test_a_line_that_leads_nowhere_is_refused(tmp_path: Path, place: dict[str, object]) -> None:
    """A place outside the file, or no place, is named with its line; nothing else is opened."""
    run = _killed_run(tmp_path)
    first, *rest = (run / "frames.jsonl").read_bytes().splitlines(keepends=True)
    line = {key: value for key, value in json.loads(first).items() if key != "crc32"}
    (run / "frames.jsonl").write_bytes(encode_line(line | place) + b"".join(rest))
    assert check_run(run).damage
    with pytest.raises(RecordError, match=r"frames\.jsonl:1"):
        open_run(run).read_frame(0)
