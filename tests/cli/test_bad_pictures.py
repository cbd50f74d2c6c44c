"""Bad pictures in every command that reads one: refused alone, and skipped in a batch."""

import json
import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from tests.cli.conftest import Labrig, SweepRun

# What a file is, and what is said of it wherever it is read.
UNREADABLE = {
    "16 bits": "not 8 bits",
    "turned by EXIF": "is to be shown turned",
    "truncated": "is truncated, damaged",
    "no picture": "no picture",
}
# Of pictures that can be read: what a measurement says of them, by the shaft and by the template.
UNMEASURABLE = {
    "wrong size": ("176 x 112 pixels, the plane map is for 352 x 224",) * 2,
    "all black": ("The picture is black", "dark, flat or masked"),
    "no needle": ("Nothing dark and straight enters", "dark, flat or masked"),
    "two needles": ("Two shafts enter the picture", None),  # of which one looks like the template
}


@pytest.fixture(scope="module")
def good(sweep: SweepRun) -> Path:
    """Return a picture of an inserted needle."""
    lines = [json.loads(line) for line in (sweep.run / "frames.jsonl").read_text().splitlines()]
    return sweep.run / next(line["file"] for line in lines if line["role"] == "final")


@pytest.fixture(scope="module")
def bad(good: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the bad pictures that a good one can be turned into, by what is wrong with them."""
    folder = tmp_path_factory.mktemp("bad")
    picture = np.asarray(cv2.imread(str(good), cv2.IMREAD_UNCHANGED), np.uint8)
    height, width = picture.shape[:2]
    written: dict[str, NDArray[np.unsignedinteger]] = {
        "16 bits": picture.astype(np.uint16) * 257,
        "wrong size": picture[: height // 2, : width // 2],
        "all black": np.zeros_like(picture),
        "no needle": np.random.default_rng(0).integers(150, 160, picture.shape, dtype=np.uint8),
        "two needles": np.minimum(picture, np.roll(picture, height // 4, axis=0)),
    }
    found = {name: folder / f"{name.replace(' ', '-')}.png" for name in (*UNREADABLE, *UNMEASURABLE)}
    for name, image in written.items():
        assert cv2.imwrite(str(found[name]), image)
    found["truncated"].write_bytes(good.read_bytes()[: good.stat().st_size // 2])
    found["no picture"].write_text("no picture")
    data = cv2.imencode(".jpg", picture)[1].tobytes()
    body = b"Exif\x00\x00" + b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    found["turned by EXIF"].write_bytes(
        data[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + data[2:]
    )
    return found


@pytest.fixture(scope="module")
def mapping(sweep: SweepRun) -> tuple[object, ...]:
    """Return the options that turn pixels of the sweep's pictures into mm."""
    calibration = sweep.run / "calibration"
    return ("--intrinsics", calibration / "intrinsics.json", "--plane", calibration / "plane.json")


@pytest.fixture
def template(sweep: SweepRun, labrig: Labrig, tmp_path: Path) -> Path:
    """Return the needle's tip, cut out of a final picture."""
    assert labrig("calibrate", "template", sweep.run, "--out", tmp_path / "tip.png").exit_code == 0
    return tmp_path / "tip.png"


@pytest.mark.parametrize("what", UNREADABLE)
def test_a_picture_that_cannot_be_read_is_refused_by_every_command(
    what: str,
    bad: dict[str, Path],
    template: Path,
    labrig: Labrig,
    mapping: tuple[object, ...],
    tmp_path: Path,
) -> None:
    """Exit code 2, with the name of the picture, the reason and a remedy."""
    picture, scale = bad[what], ("--px-per-mm", 10, "--origin-px", 30, 20, "--insertion", "right")
    for command in (
        ("calibrate", "intrinsics", picture, "--board", "9x6", "--square-mm", 25),
        ("calibrate", "plane", picture, *scale),
        (
            "calibrate",
            "template",
            picture,
            "--out",
            tmp_path / "t.png",
            "--tip-px",
            30,
            30,
            "--heading-deg",
            0,
        ),
        ("measure", "curvature", picture, "--sheath-diameter-mm", 2, *mapping),
        ("measure", "tip", picture, "--template", template, *mapping),
    ):
        done = labrig(*command, "--json")
        error = done.json()["error"]
        named = (picture.name in error["message"], UNREADABLE[what] in error["message"], bool(error["hint"]))
        assert (done.exit_code, *named, " at 0x" in error["message"]) == (2, True, True, True, False), command
    assert not (tmp_path / "t.png").exists()


@pytest.mark.parametrize(("command", "column"), [("curvature", 0), ("tip", 1)])
def test_a_batch_of_measurements_goes_on(
    command: str,
    column: int,
    good: Path,
    bad: dict[str, Path],
    template: Path,
    labrig: Labrig,
    mapping: tuple[object, ...],
) -> None:
    """Each bad picture is refused in its row with a reason, and the good ones are measured."""
    options = ("--sheath-diameter-mm", 2) if command == "curvature" else ("--template", template)
    done = labrig("measure", command, good, *bad.values(), good, *options, *mapping, "--json")
    rows = done.json()
    assert done.exit_code == 1
    expected = UNREADABLE | {name: words[column] for name, words in UNMEASURABLE.items()}
    for what, row in zip(bad, rows[1:-1], strict=True):
        if (words := expected[what]) is not None:
            assert (row["accepted"], words in row["reason"], row["tip_mm"]) == (False, True, None), what
    assert (rows[0]["accepted"], rows[0]["tip_mm"]) == (True, rows[-1]["tip_mm"])


def test_a_folder_with_bad_pictures_becomes_a_run_that_says_so(
    good: Path, bad: dict[str, Path], labrig: Labrig, mapping: tuple[object, ...], tmp_path: Path
) -> None:
    """Import names unreadable ones; reanalyze refuses bad ones with reasons and measures the good."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for path in (good, *bad.values()):
        (folder / path.name).write_bytes(path.read_bytes())
    options = ("--sheath-diameter-mm", 2, "--runs-dir", tmp_path / "runs", *mapping)
    done = labrig("import", folder, *options, "--json")
    (row,) = done.json()
    assert done.exit_code == 1
    assert f"{len(UNREADABLE)} of {len(bad) + 1} pictures could not be read" in row["reason"]
    assert [bad[what].name for what in UNREADABLE if bad[what].name not in done.err] == []
    again = labrig("reanalyze", row["run"], "--json")
    result = json.loads((Path(again.json()[0]["analysis"]) / "result.json").read_text())
    reasons = {measurement["image"]: measurement["reason"] for measurement in result["measurements"]}
    assert reasons.pop(good.name) is None
    assert set(reasons) == {bad[what].name for what in UNMEASURABLE}
    for what, (words, _) in UNMEASURABLE.items():
        assert words in reasons[bad[what].name], what
