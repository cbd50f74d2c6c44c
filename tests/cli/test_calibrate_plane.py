"""`labrig calibrate plane`: where the scale comes from, the setup file, and pictures of something else."""

import json
import re
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.cli.calibrate_plane import read_scale_from
from labrig.devices.operator import Answer
from labrig.errors import InputError
from labrig.vision.calibration_file import (
    CameraInUse,
    encode_frame,
    load_plane,
    read_camera,
    save_intrinsics,
    save_plane,
)
from labrig.vision.gel import Gel, Layer
from labrig.vision.plane import PlaneMap
from tests.cli.conftest import RIG, Done, Labrig
from tests.vision.renderer import Camera, Sheet

SIZE = (400, 300)
SHEET = Sheet(camera=Camera(SIZE, 800.0, (200.0, 150.0), (0.0,) * 5, 800.0 / 12.0, tilt_deg=0.0))
LENS = SHEET.camera.intrinsics
FRAME = ("--origin-px", 200, 150, "--insertion", "right")
Calibrate = Callable[..., Done]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a picture of 1 mm graph paper, 12 px/mm, and the lens of its camera."""
    made = tmp_path_factory.mktemp("paper")
    assert cv2.imwrite(str(made / "paper.png"), SHEET.draw())
    save_intrinsics(made / "lens.json", LENS, {})
    return made


@pytest.fixture
def calibrate(folder: Path, labrig: Labrig) -> Calibrate:
    """Calibrate the plane with the picture of graph paper."""
    return lambda *options: labrig("calibrate", "plane", folder / "paper.png", *FRAME, *options)


@pytest.fixture
def rig(tmp_path: Path) -> Path:
    """Return the rig file of a bench with such a camera; its plane map is `bench-plane.json` beside it."""
    path = tmp_path / "rig.yaml"
    text = (RIG.parent / "rig-bench.yaml").read_text(encoding="utf-8")
    for key, px in (("width_px", SIZE[0]), ("height_px", SIZE[1])):
        text = re.sub(rf"(?m)^(  {key}:) \d+", rf"\1 {px}", text)
    path.write_text(text, encoding="utf-8")
    return path


def test_a_stated_scale_is_enough_and_the_map_says_what_it_implies(
    calibrate: Calibrate, tmp_path: Path
) -> None:
    """15 % off is near enough. Width and height of the picture are printed and are in the JSON."""
    width, height = SHEET.camera.picture_size_mm()
    out = tmp_path / "plane.json"
    done = calibrate("--px-per-mm", 13.8, "--out", out)
    assert done.exit_code == 0, done.err
    assert f"The picture is {width:.0f} mm wide and {height:.0f} mm high at the paper." in done.out
    assert load_plane(out, None).picture_mm == pytest.approx((width, height), rel=0.01)
    document = calibrate("--px-per-mm", 10.2, "--json").json()
    assert {"accepted", "reasons", "rms_mm", "holdout_rms_mm", "mm_per_px"} < set(document)
    assert document["picture_mm"] == pytest.approx([width, height], rel=0.01)
    assert document["not_in_interval"] == ["lens", "surface", "the height of the paper over the needle"]


@pytest.mark.parametrize("said", ["option", "rig"])
def test_the_distance_by_tape_tells_the_scale_with_the_lens(
    said: str, calibrate: Calibrate, rig: Path, folder: Path
) -> None:
    """As an option, or in the rig file; without the lens the option is wrong input."""
    if said == "option":
        how: tuple[object, ...] = ("--distance-mm", 70)
        assert calibrate(*how, "--json").exit_code == 2
    else:
        text = rig.read_text(encoding="utf-8")
        rig.write_text(text.replace("distance_mm: null", "distance_mm: 70"), encoding="utf-8")
        how = ("--rig", rig)
    done = calibrate(*how, "--intrinsics", folder / "lens.json", "--json")
    assert done.exit_code == 0, done.err
    assert done.json()["camera_distance_mm"] == pytest.approx(800.0 / 12.0, rel=0.01)


def test_the_rig_s_last_map_tells_the_scale(calibrate: Calibrate, rig: Path, tmp_path: Path) -> None:
    """A scale that the sheet contradicts is refused in a sentence; the option corrects it."""
    last = tmp_path / "bench-plane.json"
    save_plane(last, PlaneMap.from_scale(11.0, (100.0, 100.0), "right", SIZE), {})
    assert calibrate("--rig", rig).exit_code == 0
    save_plane(last, PlaneMap.from_scale(60.0, (100.0, 100.0), "right", SIZE), {})
    done = calibrate("--rig", rig, "--json")
    document = done.json()
    assert (done.exit_code, document["accepted"], document["mm_per_px"]) == (1, False, None)
    assert "px apart" in document["reasons"][0]
    assert calibrate("--rig", rig, "--px-per-mm", 12).exit_code == 0


def test_two_marks_and_the_millimetres_between_them_tell_the_scale(folder: Path) -> None:
    """Their distance in pixels over their distance in millimetres; no is refused."""
    marks = (Answer(confirmed=True, pixel=(10.0, 20.0)), Answer(confirmed=True, pixel=(130.0, 20.0)))
    answers = iter((*marks, Answer(confirmed=True, reading=10.0), Answer(confirmed=False)))

    class Person:
        def ask(self, *_question: object) -> Answer:
            return next(answers)

    assert read_scale_from(Person(), folder / "gone.png") == pytest.approx(12.0)
    with pytest.raises(InputError, match="not told"):
        read_scale_from(Person(), folder / "gone.png")


def test_the_settings_of_a_test_frame_are_kept(labrig: Labrig, tmp_path: Path) -> None:
    """A picture that carries its camera gives the plane map what a later focus is compared with."""
    frame, out = tmp_path / "frame.png", tmp_path / "plane.json"
    frame.write_bytes(encode_frame(SHEET.draw(), CameraInUse(settings={"focus": 30})))
    assert labrig("calibrate", "plane", frame, *FRAME, "--px-per-mm", 12, "--out", out).exit_code == 0
    assert read_camera(out).settings == {"focus": 30}


def test_a_setup_file_describes_the_gel(calibrate: Calibrate, folder: Path, tmp_path: Path) -> None:
    """Its deviations move the map that is read back, those that are missing are named; a wrong key is refused."""
    setup, out = tmp_path / "setup.yaml", tmp_path / "plane.json"
    setup.write_text(
        "paper_sigma_mm: 0.5\n"
        "gel: {index: 1.35, index_sigma: 0.01, depth_mm: 5, layers: [{index: glass, thickness_mm: 3}]}\n",
        encoding="utf-8",
    )
    known = ("--intrinsics", folder / "lens.json", "--distance-mm", 67, "--setup", setup)
    done = calibrate(*known, "--out", out)
    assert done.exit_code == 0, done.err
    assert "the gel's depth, the thickness of layer 1, the tilt of the gel's surface" in done.out
    plane = load_plane(out, LENS)
    assert plane.gel == Gel(
        index=1.35, index_sigma=0.01, depth_mm=5.0, layers=(Layer(index="glass", thickness_mm=3.0),)
    )
    ends = [(50.3, 100.7), (350.0, 250.0)]
    moves = [np.linalg.norm(np.diff(moved, axis=0)) for moved in plane.map_by_variants(ends)["surface"]]
    assert len(set(np.round(moves, 6))) == 2
    setup.write_text("gel: {index: 1.35, depth: 5}\n", encoding="utf-8")
    wrong = calibrate(*known)
    assert (wrong.exit_code, "depth" in wrong.err) == (2, True)


@pytest.mark.parametrize("kind", ["blank", "board"])
def test_a_picture_of_something_else_gives_no_map(kind: str, labrig: Labrig, tmp_path: Path) -> None:
    """What the picture lacks, and what to show instead; the JSON has the same reason and no numbers."""
    picture, out = tmp_path / "wrong.png", tmp_path / "plane.json"
    squares = 40 + 180 * ((np.indices((300, 400)) // 40).sum(axis=0) % 2)
    drawn = {"blank": np.full((300, 400), 180, np.uint8), "board": squares.astype(np.uint8)}
    assert cv2.imwrite(str(picture), drawn[kind])
    done = labrig("calibrate", "plane", picture, *FRAME, "--px-per-mm", 8, "--out", out, "--json")
    document = json.loads(done.out)
    assert not out.exists()
    assert (done.exit_code, document["accepted"], document["mm_per_px"]) == (1, False, None)
    assert "graph paper" in done.err.partition("hint: ")[2]
