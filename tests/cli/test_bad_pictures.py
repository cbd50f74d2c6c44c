"""Bad pictures in every command that reads one: refused alone, and skipped in a batch."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.cli.bad_pictures import write_bad_pictures
from tests.cli.conftest import RIG, Labrig, SweepRun

TEMPLATE = RIG.parent / "simulated-tip.png"

# What a file is, and what is said of it wherever it is read.
UNREADABLE = {
    "16 bits": "not 8 bits",
    "turned by EXIF": "is to be shown turned by 90 degrees",
    "truncated": "is truncated, damaged",
    "no picture": "no picture",
}
# Of pictures that can be read: what a measurement says of them, by the shaft and by the template.
UNMEASURABLE = {
    "wrong size": ("640 x 360 pixels, the plane map is for 1280 x 720",) * 2,
    "all black": ("The picture is black", "dark, flat or masked"),
    "no needle": ("Nothing dark and straight enters", "dark, flat or masked"),
    "two needles": ("Two shafts enter the picture", "they cannot be told apart"),
    "needle out of the frame": ("runs out of the picture", ""),
}


@pytest.fixture(scope="module")
def good(sweep: SweepRun) -> Path:
    """Return a picture of an inserted needle."""
    lines = [json.loads(line) for line in (sweep.run / "frames.jsonl").read_text().splitlines()]
    return sweep.run / next(line["file"] for line in lines if line["role"] == "final")


@pytest.fixture(scope="module")
def bad(good: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the bad pictures by what is wrong with them."""
    return write_bad_pictures(good, tmp_path_factory.mktemp("bad"))


def mapping(sweep: SweepRun) -> tuple[object, ...]:
    """Return the options that turn pixels of the sweep's pictures into mm."""
    calibration = sweep.run / "calibration"
    return ("--intrinsics", calibration / "intrinsics.json", "--plane", calibration / "plane.json")


def commands(picture: Path, sweep: SweepRun, out: Path) -> dict[str, tuple[object, ...]]:
    """Return every command line that measures or calibrates from this one picture."""
    lens = sweep.run / "calibration" / "intrinsics.json"
    return {
        "intrinsics": ("calibrate", "intrinsics", picture, "--board", "9x6", "--square-mm", 25),
        "plane": (
            "calibrate", "plane", picture, "--intrinsics", lens, "--px-per-mm", 10, "--origin-px", 300, 200,
            "--insertion", "right",
        ),
        "template": ("calibrate", "template", picture, "--out", out, "--tip-px", 30, 30, "--heading-deg", 0),
        "curvature": ("measure", "curvature", picture, "--sheath-diameter-mm", 2, *mapping(sweep)),
        "tip": ("measure", "tip", picture, "--template", TEMPLATE, *mapping(sweep)),
    }  # fmt: skip


@pytest.mark.parametrize("what", UNREADABLE)
def test_a_picture_that_cannot_be_read_is_refused_by_every_command(
    what: str, bad: dict[str, Path], labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """Exit code 2, with the name of the picture, the reason and a remedy."""
    for name, command in commands(bad[what], sweep, tmp_path / "tip.png").items():
        done = labrig(*command, "--json")
        error = done.json()["error"]
        assert done.exit_code == 2, name
        assert bad[what].name in error["message"]
        assert UNREADABLE[what] in error["message"]
        assert error["hint"]
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("what", UNMEASURABLE)
def test_a_picture_that_shows_something_else_is_refused_by_every_command(
    what: str, bad: dict[str, Path], labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """The answer is no, or wrong input for another size; nothing is written."""
    size = what == "wrong size"
    asked = commands(bad[what], sweep, tmp_path / "tip.png")
    del asked["template"]  # a person says where the tip is
    for name, command in asked.items():
        done = labrig(*command)
        assert done.exit_code == (2 if size and name != "intrinsics" else 1), (name, done)
        assert len(f"{done.out}{done.err}".strip()) > 40, name
        assert "Traceback" not in done.err
        if name == "curvature":
            assert UNMEASURABLE[what][0].lower() in f"{done.out}{done.err}".lower(), name
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(("command", "column"), [("curvature", 0), ("tip", 1)])
def test_a_batch_of_measurements_goes_on(
    command: str,
    column: int,
    good: Path,
    bad: dict[str, Path],
    labrig: Labrig,
    sweep: SweepRun,
    tmp_path: Path,
) -> None:
    """Each bad picture is refused in its row with a reason, and the good ones are measured."""
    line = commands(good, sweep, tmp_path)[command]
    done = labrig(*line, *bad.values(), good, "--json")
    rows = done.json()
    assert done.exit_code == 1
    assert [row["accepted"] for row in rows] == [True, *[False] * len(bad), True]
    expected = UNREADABLE | {name: words[column] for name, words in UNMEASURABLE.items()}
    for what, row in zip(bad, rows[1:-1], strict=True):
        assert expected[what] in row["reason"], what
        assert row["tip_mm"] is None or what == "needle out of the frame"
    assert rows[0]["tip_mm"] == rows[-1]["tip_mm"]


def test_a_folder_with_bad_pictures_becomes_a_run_that_says_so(
    good: Path, bad: dict[str, Path], labrig: Labrig, sweep: SweepRun, tmp_path: Path
) -> None:
    """Import names unreadable ones; reanalyze refuses bad ones with reasons and measures the good."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for path in (good, *bad.values()):
        (folder / path.name).write_bytes(path.read_bytes())
    options = ("--sheath-diameter-mm", 2, "--runs-dir", tmp_path / "runs", *mapping(sweep))
    done = labrig("import", folder, *options, "--json")
    (row,) = done.json()
    assert done.exit_code == 1
    assert f"{len(UNREADABLE)} of {len(bad) + 1} pictures could not be read" in row["reason"]
    for what in UNREADABLE:
        assert bad[what].name in done.err
    run = Path(row["run"])
    again = labrig("reanalyze", run, "--json")
    result = json.loads((Path(again.json()[0]["analysis"]) / "result.json").read_text())
    reasons = {measurement["image"]: measurement["reason"] for measurement in result["measurements"]}
    assert reasons.pop(good.name) is None
    assert set(reasons) == {bad[what].name for what in UNMEASURABLE}
    for what, (words, _) in UNMEASURABLE.items():
        assert words in reasons[bad[what].name], what


def board(path: Path, shift: int, size: tuple[int, int] = (640, 480)) -> Path:
    """Return the path of a drawn picture of a board of 7 x 5 inner corners."""
    squares = (np.indices((6 * 40, 8 * 40)) // 40).sum(axis=0) % 2
    sheet = np.full(size[::-1], 220, np.uint8)
    sheet[60 : 60 + 240, 60 + shift : 60 + shift + 320] = np.where(squares == 0, 30, 220)
    cv2.imwrite(str(path), cv2.GaussianBlur(sheet, (0, 0), 1.0))
    return path


def test_a_calibration_lists_each_picture_that_it_could_not_use(
    bad: dict[str, Path], labrig: Labrig, tmp_path: Path
) -> None:
    """Pictures without the board, of another size, and unreadable ones each have a reason."""
    views = [board(tmp_path / f"{shift}.png", shift) for shift in (0, 40, 80)]
    other = board(tmp_path / "other.png", 0, (800, 480))
    empty = tmp_path / "empty.png"
    cv2.imwrite(str(empty), np.random.default_rng(0).integers(100, 200, (480, 640), dtype=np.uint8))
    files = (*views, other, empty, *(bad[what] for what in UNREADABLE))
    done = labrig("calibrate", "intrinsics", *files, "--board", "7x5", "--square-mm", 25, "--json")
    document = done.json()
    reasons = {view["image"]: view["reason"] for view in document["views"] if not view["used"]}
    assert done.exit_code == 1
    assert [view["image"] for view in document["views"] if view["used"]] == [path.name for path in views]
    assert "800 x 480 pixels, the calibration is of 640 x 480" in reasons[other.name]
    assert "no board of 7 x 5" in reasons[empty.name]
    for what, words in UNREADABLE.items():
        assert words in reasons[bad[what].name]


def test_colour_is_measured_like_grey(good: Path, labrig: Labrig, sweep: SweepRun, tmp_path: Path) -> None:
    """Three equal channels give the same numbers as a grey picture."""
    colour = tmp_path / "colour.png"
    cv2.imwrite(str(colour), cv2.cvtColor(cv2.imread(str(good), 0), cv2.COLOR_GRAY2BGR))
    line = commands(good, sweep, tmp_path)["curvature"]
    grey, same = labrig(*line, colour, "--json").json()
    assert same["radius_mm"] == pytest.approx(grey["radius_mm"], abs=1e-6)
