"""`labrig calibrate plane`: what the scale implies, the comparison with the rig's last map, and wrong pictures."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from labrig.vision.calibration_file import load_plane, read_camera, save_plane
from labrig.vision.camera_frame import CameraInUse, encode_frame
from labrig.vision.plane import PlaneMap
from tests.cli.conftest import RIG, Done, Labrig
from tests.vision import no_graph_paper
from tests.vision.paper_renderer import Camera, Sheet, draw_sheet

SIZE = (400, 300)
SHEET = Sheet(px_per_mm=12.0, camera=Camera(SIZE, focal_px=800.0, centre_px=(200.0, 150.0), k1=0.0, k2=0.0))
FRAME = ("--origin-px", 200, 150, "--insertion", "right")
Calibrate = Callable[..., Done]


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a picture of 1 mm graph paper, 12 px/mm."""
    path = tmp_path_factory.mktemp("paper") / "paper.png"
    assert cv2.imwrite(str(path), draw_sheet(SHEET))
    return path


@pytest.fixture
def calibrate(paper: Path, labrig: Labrig) -> Calibrate:
    """Calibrate the plane with the picture of graph paper."""
    return lambda *options: labrig("calibrate", "plane", paper, *FRAME, *options)


def save_last(path: Path, px_per_mm: float, size: tuple[int, int] = SIZE) -> Path:
    """Write an earlier plane map of such a camera."""
    plane = PlaneMap.from_scale(px_per_mm, (100.0, 100.0), "right", size)
    save_plane(path, plane, {"created": "2026-10-03T09:00:00+00:00"})
    return path


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return the rig file of a bench with such a camera; its plane map is `bench-plane.json` beside it."""
    path = tmp_path / "rig.yaml"
    text = (RIG.parent / "rig-bench.yaml").read_text(encoding="utf-8")
    for key, px in (("width_px", SIZE[0]), ("height_px", SIZE[1])):
        text = re.sub(rf"(?m)^(  {key}:) \d+", rf"\1 {px}", text)
    path.write_text(text, encoding="utf-8")
    return path


def test_the_settings_of_a_test_frame_are_kept(labrig: Labrig, tmp_path: Path) -> None:
    """A picture that carries its camera gives the plane map what a later focus is compared with."""
    frame, out = tmp_path / "frame.png", tmp_path / "plane.json"
    frame.write_bytes(encode_frame(draw_sheet(SHEET), CameraInUse(settings={"focus": 30})))
    assert labrig("calibrate", "plane", frame, *FRAME, "--out", out).exit_code == 0
    assert read_camera(out).settings == {"focus": 30}


def test_the_scale_is_said_in_words_that_a_ruler_checks(calibrate: Calibrate, tmp_path: Path) -> None:
    """Width and height of the picture are printed and are in the JSON; without an earlier map, --rig is named."""
    width, height = SHEET.picture_size_mm()
    out = tmp_path / "plane.json"
    done = calibrate("--out", out)
    assert done.exit_code == 0
    assert f"The picture is {width:.0f} mm wide and {height:.0f} mm high at the paper." in done.out
    assert "compared with no earlier plane map; --rig FILE" in done.out
    document = calibrate("--json").json()
    assert document["picture_mm"] == pytest.approx([width, height], rel=0.01)
    assert document["view"] in done.out
    assert document["scale_comparison"] is None
    assert document["not_in_interval"] == ["lens", "surface", "the height of the paper over the needle"]
    assert load_plane(out, None).picture_mm == pytest.approx((width, height), rel=0.01)


def test_a_scale_five_times_that_of_the_rig_is_refused_until_the_camera_is_said_to_have_moved(
    calibrate: Calibrate, rig: Path, tmp_path: Path
) -> None:
    """Exit code 1 with both scales, ratio and remedy, and nothing written; with --camera-moved it is written."""
    save_last(tmp_path / "bench-plane.json", 60.0)
    out = tmp_path / "plane.json"
    done = calibrate("--rig", rig, "--out", out)
    assert (done.exit_code, out.exists()) == (1, False)
    assert "times that of the last plane map" in done.out
    assert "and 0.01667 mm/px), as if other lines of the paper had been counted" in done.out
    assert "bench-plane.json of 2026-10-03" in done.out
    assert "if the camera, its lens or the height of the paper was changed, give --camera-moved" in done.out
    document = calibrate("--rig", rig, "--json").json()
    assert not document["accepted"]
    assert document["scale_comparison"]["ratio"] == pytest.approx(5.0, rel=0.01)
    moved = calibrate("--rig", rig, "--out", out, "--camera-moved")
    assert (moved.exit_code, out.exists()) == (0, True)
    assert document["scale_comparison"]["sentence"] in moved.out


def test_without_a_rig_the_map_that_is_replaced_is_the_last(calibrate: Calibrate, tmp_path: Path) -> None:
    """A scale 7 % off is accepted and stated, with what to do if the camera was not moved."""
    out = save_last(tmp_path / "plane.json", 12.84)
    done = calibrate("--out", out, "--force")
    assert done.exit_code == 0
    assert "the last plane map, plane.json of 2026-10-03" in done.out
    assert "If neither the camera nor its lens nor the height of the paper was changed since" in done.out
    replaced = load_plane(out, None)
    assert replaced.mm_per_px == pytest.approx(1.0 / 12.0, rel=0.01)


def test_a_scale_that_needs_a_person_replaces_no_file(calibrate: Calibrate, tmp_path: Path) -> None:
    """With --force the good map stays, so that the same mistake made twice is refused twice."""
    out = save_last(tmp_path / "plane.json", 60.0)
    before = out.read_bytes()
    done = calibrate("--out", out, "--force")
    assert (done.exit_code, out.read_bytes() == before) == (1, True)
    assert f"not written: {out}" in done.err


def test_a_last_map_that_cannot_be_used_is_said_to_be_left_out(
    calibrate: Calibrate, rig: Path, tmp_path: Path
) -> None:
    """A map of another camera's pictures, or a damaged file, is named, and does not stop the calibration."""
    last = save_last(tmp_path / "plane.json", 12.0, (1280, 720))
    other = calibrate("--out", last, "--force")
    assert (other.exit_code, "1280 x 720 pixels, this one has 400 x 300" in other.out) == (0, True)
    (tmp_path / "bench-plane.json").write_text("{", encoding="utf-8")
    damaged = calibrate("--rig", rig)
    assert (damaged.exit_code, "not compared with the last plane map" in damaged.out) == (0, True)
    (tmp_path / "bench-plane.json").unlink()
    assert "no earlier plane map: the rig has none yet." in calibrate("--rig", rig).out
    moved = calibrate("--rig", rig, "--camera-moved").out
    assert "the rig has none yet; --camera-moved had no effect." in moved


def test_a_pitch_that_the_heavier_lines_contradict_is_refused(calibrate: Calibrate, tmp_path: Path) -> None:
    """5 typed for a 1/5/10 sheet: exit code 1, what was counted, what would fit, and what the scale would imply."""
    out = tmp_path / "plane.json"
    done = calibrate("--pitch-mm", 5, "--out", out)
    assert (done.exit_code, out.exists()) == (1, False)
    assert "every 5th line is heavier" in done.out
    assert "; 1 mm would fit" in done.out
    assert "The picture is 166 mm wide" in done.out


@pytest.mark.parametrize(
    ("option", "file", "what"),
    [
        ("--intrinsics", "simulated-intrinsics.json", "the lens's calibration"),
        ("--rig", "rig-simulated.yaml", "the camera of the rig simulated"),
    ],
)
def test_a_picture_of_another_camera_is_refused(
    option: str, file: str, what: str, calibrate: Calibrate
) -> None:
    """A lens or a rig with pictures of another size is wrong input, with both sizes."""
    done = calibrate(option, RIG.parent / file, "--json")
    error: Any = done.json()["error"]
    assert done.exit_code == 2
    assert f"400 x 300 pixels, {what} is for 1280 x 720" in error["message"]


@pytest.mark.parametrize(
    ("draw", "words"),
    [
        (no_graph_paper.draw_lined_paper, "no grid of ruled lines"),
        (no_graph_paper.draw_dotted_paper, "no grid of ruled lines"),
        (no_graph_paper.draw_chessboard, "no grid of ruled lines"),
        (no_graph_paper.draw_keyboard, "grid"),
        (no_graph_paper.draw_second_grid, "two grids"),
    ],
    ids=["lined", "dotted", "chessboard", "keyboard", "second grid"],
)
def test_a_picture_of_something_else_gives_no_map(
    draw: Callable[[], NDArray[np.uint8]], words: str, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 1, what the picture shows, and what to show instead; the JSON has the same reason and no numbers."""
    picture, out = tmp_path / "wrong.png", tmp_path / "plane.json"
    assert cv2.imwrite(str(picture), draw())
    done = labrig("calibrate", "plane", picture, *FRAME, "--out", out, "--json")
    document = json.loads(done.out)
    assert (done.exit_code, document["accepted"], document["mm_per_px"], out.exists()) == (
        1,
        False,
        None,
        False,
    )
    assert words in document["reasons"][0]
    assert "graph paper" in done.err.partition("hint: ")[2]
