"""Commands that read pictures: measure, calibrate plane and template, devices camera; and bad pictures in each."""

import json
import math
import re
import signal
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from urllib.request import urlopen

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

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
from tests.cli.conftest import KEPT_MAPPING, RIG, ROOT, Done, Labrig
from tests.vision.renderer import Camera, Sheet

RUN = ROOT / "tests" / "records" / "steerability"
GOOD = RUN / "frames" / "000003.png"
"""An inserted needle."""

UNREADABLE = {
    "16 bits": "not 8 bits", "turned by EXIF": "is to be shown turned", "truncated": "is truncated, damaged",
    "no picture": "no picture",
}  # fmt: skip
"""What a file is, and what is said of it wherever it is read."""
UNMEASURABLE = {
    "wrong size": ("176 x 112 pixels, the plane map is for 352 x 224",) * 2,
    "all black": ("The picture is black", "dark, flat or masked"),
    "no needle": ("Nothing dark and straight enters", "dark, flat or masked"),
    "two needles": ("Two shafts enter the picture", None),  # of which one looks like the template
}
"""Of pictures that can be read: what a measurement says of them, by the shaft and by the template."""


def _encode(image: NDArray[np.unsignedinteger], suffix: str = ".png") -> bytes:
    return cv2.imencode(suffix, image)[1].tobytes()


@pytest.fixture(scope="module")
def bad(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Return the bad pictures that a good one can be turned into, by what is wrong with them."""
    folder = tmp_path_factory.mktemp("bad")
    picture = np.asarray(cv2.imread(str(GOOD), cv2.IMREAD_UNCHANGED), np.uint8)
    height, width = picture.shape[:2]
    jpeg = _encode(picture, ".jpg")
    body = b"Exif\x00\x00" + b"MM\x00*" + struct.pack(">IHHHIHHI", 8, 1, 0x0112, 3, 1, 6, 0, 0)
    written = {
        "16 bits": _encode(picture.astype(np.uint16) * 257),
        "turned by EXIF": jpeg[:2] + b"\xff\xe1" + struct.pack(">H", len(body) + 2) + body + jpeg[2:],
        "truncated": GOOD.read_bytes()[: GOOD.stat().st_size // 2],
        "no picture": b"no picture",
        "wrong size": _encode(picture[: height // 2, : width // 2]),
        "all black": _encode(np.zeros_like(picture)),
        "no needle": _encode(np.random.default_rng(0).integers(150, 160, picture.shape, dtype=np.uint8)),
        "two needles": _encode(np.minimum(picture, np.roll(picture, height // 4, axis=0))),
    }
    found = {name: folder / f"{name.replace(' ', '-')}.png" for name in written}
    for name, path in found.items():
        path.write_bytes(written[name])
    return found


@pytest.fixture
def template(labrig: Labrig, tmp_path: Path) -> Path:
    """Return the needle's tip, cut out of a final picture."""
    assert labrig("calibrate", "template", RUN, "--out", tmp_path / "tip.png").exit_code == 0
    return tmp_path / "tip.png"


@pytest.mark.parametrize("what", UNREADABLE)
def test_a_picture_that_cannot_be_read_is_refused_by_every_command(
    what: str, bad: dict[str, Path], template: Path, labrig: Labrig, tmp_path: Path
) -> None:
    """Exit code 2, with the name of the picture, the reason and a remedy."""
    picture, scale = bad[what], ("--px-per-mm", 10, "--origin-px", 30, 20, "--insertion", "right")
    by_hand = ("--out", tmp_path / "t.png", "--tip-px", 30, 30, "--heading-deg", 0)
    for command in (
        ("calibrate", "intrinsics", picture, "--board", "9x6", "--square-mm", 25),
        ("calibrate", "plane", picture, *scale),
        ("calibrate", "template", picture, *by_hand),
        ("measure", "curvature", picture, "--sheath-diameter-mm", 2, *KEPT_MAPPING),
        ("measure", "tip", picture, "--template", template, *KEPT_MAPPING),
    ):
        done = labrig(*command, "--json")
        error = done.json()["error"]
        named = (picture.name in error["message"], UNREADABLE[what] in error["message"], bool(error["hint"]))
        assert (done.exit_code, *named, " at 0x" in error["message"]) == (2, True, True, True, False), command
    assert not (tmp_path / "t.png").exists()


@pytest.mark.parametrize(("command", "column"), [("curvature", 0), ("tip", 1)])
def test_a_batch_of_measurements_goes_on(
    command: str, column: int, bad: dict[str, Path], template: Path, labrig: Labrig
) -> None:
    """Each bad picture is refused in its row with a reason, and the good ones are measured."""
    options = ("--sheath-diameter-mm", 2) if command == "curvature" else ("--template", template)
    done = labrig("measure", command, GOOD, *bad.values(), GOOD, *options, *KEPT_MAPPING, "--json")
    rows = done.json()
    assert done.exit_code == 1
    expected = UNREADABLE | {name: words[column] for name, words in UNMEASURABLE.items()}
    for what, row in zip(bad, rows[1:-1], strict=True):
        if (words := expected[what]) is not None:
            assert (row["accepted"], words in row["reason"], row["tip_mm"]) == (False, True, None), what
    assert (rows[0]["accepted"], rows[0]["tip_mm"]) == (True, rows[-1]["tip_mm"])


def test_a_folder_with_bad_pictures_becomes_a_run_that_says_so(
    bad: dict[str, Path], labrig: Labrig, tmp_path: Path
) -> None:
    """Import names unreadable ones; reanalyze refuses bad ones with reasons and measures the good."""
    folder = tmp_path / "pictures"
    folder.mkdir()
    for path in (GOOD, *bad.values()):
        (folder / path.name).write_bytes(path.read_bytes())
    options = ("--sheath-diameter-mm", 2, "--runs-dir", tmp_path / "runs", *KEPT_MAPPING)
    done = labrig("import", folder, *options, "--json")
    (row,) = done.json()
    assert done.exit_code == 1
    assert f"{len(UNREADABLE)} of {len(bad) + 1} pictures could not be read" in row["reason"]
    assert [bad[what].name for what in UNREADABLE if bad[what].name not in done.err] == []
    assert re.search(r"measurement \d: radius \(mm\) +- +[\d.]+\n", labrig("reanalyze", row["run"]).out)
    again = labrig("reanalyze", row["run"], "--json")
    result = json.loads((Path(again.json()[0]["analysis"]) / "result.json").read_text())
    reasons = {measurement["image"]: measurement["reason"] for measurement in result["measurements"]}
    assert (reasons.pop(GOOD.name), set(reasons)) == (None, {bad[what].name for what in UNMEASURABLE})
    for what, (words, _) in UNMEASURABLE.items():
        assert words in reasons[bad[what].name], what


FINALS = [RUN / "frames" / f"{frame:06}.png" for frame in (3, 7)]


def test_a_template_of_one_frame_finds_the_tips_of_others(labrig: Labrig, tmp_path: Path) -> None:
    """Where their shafts end; near a place that is given, and not elsewhere. Only --force replaces a picture."""
    template = tmp_path / "tip.png"
    cut = ("calibrate", "template", RUN, "--out", template)
    assert abs(labrig(*cut, "--json").json()["heading_deg"]) < 90
    assert (labrig(*cut).exit_code, labrig(*cut, "--force").exit_code) == (2, 0)
    shaft = labrig("measure", "curvature", *FINALS, *KEPT_MAPPING, "--json", "--sheath-diameter-mm", 2).json()
    asked = ("--template", template, *KEPT_MAPPING, "--json")
    tips = labrig("measure", "tip", *FINALS, *asked).json()
    for row, other in zip(tips, shaft, strict=True):
        assert (row["accepted"], math.dist(row["tip_mm"], other["tip_mm"]) < 0.4) == (True, True), row[
            "reason"
        ]
    u, v = tips[0]["tip_px"]
    beside = (
        "measure", "tip", FINALS[0], *asked, "--heading-deg", math.degrees(tips[0]["heading_rad"]),
        "--near-px",
    )  # fmt: skip
    assert labrig(*beside, u + 6, v - 5).json()[0]["tip_px"] == pytest.approx([u, v], abs=0.2)
    far = labrig(*beside, 40, 200)
    assert (far.exit_code, far.json()[0]["tip_px"], bool(far.json()[0]["reason"])) == (1, None, True)


def test_a_picture_and_both_ends_by_hand_need_no_map(labrig: Labrig, tmp_path: Path) -> None:
    """If tip and heading are given the shaft is not measured, and no plane map is needed."""
    out = tmp_path / "by-hand.png"
    asked = ("calibrate", "template", FINALS[0], "--tip-px", 150, 110, "--out", out, "--heading-deg", -30)
    assert labrig(*asked).exit_code == 0
    assert json.loads(out.with_suffix(".json").read_text())["heading_rad"] == pytest.approx(math.radians(-30))


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


def test_the_distance_by_tape_tells_the_scale_with_the_lens(
    calibrate: Calibrate, rig: Path, folder: Path
) -> None:
    """As an option, or in the rig file."""
    rig.write_text(
        rig.read_text(encoding="utf-8").replace("distance_mm: null", "distance_mm: 70"), encoding="utf-8"
    )
    for how in (("--distance-mm", 70), ("--rig", rig)):
        done = calibrate(*how, "--intrinsics", folder / "lens.json", "--json")
        assert done.exit_code == 0, done.err
        assert done.json()["camera_distance_mm"] == pytest.approx(800.0 / 12.0, rel=0.01)


def test_the_rig_s_last_map_tells_the_scale(calibrate: Calibrate, rig: Path, tmp_path: Path) -> None:
    """A scale that the sheet contradicts is refused in a sentence; the option corrects it."""
    for px_per_mm, exit_code in ((11.0, 0), (60.0, 1)):
        plane = PlaneMap.from_scale(px_per_mm, (100.0, 100.0), "right", SIZE)
        save_plane(tmp_path / "bench-plane.json", plane, {})
        done = calibrate("--rig", rig, "--json")
        assert (done.exit_code, done.json()["accepted"]) == (exit_code, not exit_code)
    assert (done.json()["mm_per_px"], "px apart" in done.json()["reasons"][0]) == (None, True)
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


SQUARES = 40 + 180 * ((np.indices((300, 400)) // 40).sum(axis=0) % 2)


@pytest.mark.parametrize("drawn", [np.full((300, 400), 180), SQUARES], ids=("blank", "board"))
def test_a_picture_of_something_else_gives_no_map(
    drawn: NDArray[np.int_], labrig: Labrig, tmp_path: Path
) -> None:
    """What the picture lacks, and what to show instead; the JSON has the same reason and no numbers."""
    picture, out = tmp_path / "wrong.png", tmp_path / "plane.json"
    picture.write_bytes(_encode(drawn.astype(np.uint8)))
    done = labrig("calibrate", "plane", picture, *FRAME, "--px-per-mm", 8, "--out", out, "--json")
    document = done.json()
    told = (done.exit_code, document["accepted"], document["mm_per_px"], out.exists())
    assert told == (1, False, None, False)
    assert "graph paper" in done.err.partition("hint: ")[2]


SHOWN_SIZE = (224, 352)
MakeRig = Callable[..., Path]


def _draw_paper() -> NDArray[np.uint8]:
    """Draw lines 16 px apart, slightly blurred."""
    paper = np.full(SHOWN_SIZE, 180.0, np.float32)
    for at in range(8, SHOWN_SIZE[1], 16):
        paper[:, at : at + 2] = 90
        paper[at : at + 2] = 90
    noise = np.random.default_rng(1).normal(0.0, 1.5, SHOWN_SIZE)
    return np.clip(cv2.GaussianBlur(paper, (0, 0), 1.0) + noise, 0, 255).astype(np.uint8)


@pytest.fixture
def make_rig(tmp_path: Path) -> MakeRig:
    """Return what writes a simulated rig whose camera shows a picture again and again."""

    def make(image: NDArray[np.uint8], pictures: int = 16) -> Path:
        (tmp_path / "pictures").mkdir()
        for number in range(pictures):
            (tmp_path / "pictures" / f"{number:06d}.png").write_bytes(_encode(image))
        camera = "camera: {driver: files, source: pictures, width_px: 352, height_px: 224, rate_hz: 30}\n\n"
        lens = (
            "width_px: 352, height_px: 224, fx_px: 493, fy_px: 494, cx_px: 178, cy_px: 110, distance_mm: 63"
        )
        text = re.sub(r"  lens:\n(    .*\n)+", f"  lens: {{{lens}}}\n", RIG.read_text(encoding="utf-8"))
        rig = tmp_path / "rig.yaml"
        rig.write_text(re.sub(r"^camera:\n(?:  .*\n|\n)*", camera, text, count=1, flags=re.MULTILINE))
        return rig

    return make


def test_pictures_are_scored_and_the_last_is_saved_once(
    labrig: Labrig, make_rig: MakeRig, tmp_path: Path
) -> None:
    """One document has the scores of each picture; a file that exists is never replaced."""
    image, frame = _draw_paper(), tmp_path / "frame.png"
    command = ("devices", "camera", "--rig", make_rig(image), "--save", frame)
    done = labrig(*command, "--json")
    document = done.json()
    assert (done.exit_code, document["ok"], len(document["pictures"])) == (0, True, 16)
    scores = {score["name"]: score["value"] for score in document["pictures"][-1]["scores"]}
    assert (2.0 < scores["focus"] < 6.0, scores["flicker"]) == (True, 0.0)
    assert document["pictures"][0]["scores"][-1]["value"] is None
    assert np.array_equal(cv2.imread(str(frame), cv2.IMREAD_UNCHANGED), image)
    kept = frame.read_bytes()
    again = labrig(*command)
    assert (again.exit_code, frame.read_bytes(), "choose another name" in again.err) == (2, kept, True)


def test_a_blurred_picture_is_no_good(labrig: Labrig, make_rig: MakeRig) -> None:
    """The exit code is 1, and the table names value, limit and remedy."""
    v, u = np.mgrid[: SHOWN_SIZE[0], : SHOWN_SIZE[1]]
    disc = np.where(np.hypot(u - 160, v - 110) < 70, 170.0, 60.0).astype(np.float32)
    done = labrig("devices", "camera", "--rig", make_rig(cv2.GaussianBlur(disc, (0, 0), 6).astype(np.uint8)))
    assert done.exit_code == 1
    assert re.search(r"^FAIL  focus: edges are 1\d\.\d px wide \(at most 6 px\)$", done.out, re.MULTILINE)
    assert "change camera.focus in the rig file" in done.out


def test_the_page_shows_the_pictures_until_interrupted(make_rig: MakeRig) -> None:
    """A browser gets scores and picture by the address that was printed; Ctrl+C ends with 130."""
    rig, pipe = make_rig(_draw_paper(), pictures=1000), subprocess.PIPE
    command = [sys.executable, "-m", "labrig", "devices", "camera", "--rig", str(rig), "--web"]
    with subprocess.Popen(command, stdout=pipe, stderr=pipe, text=True) as running:
        assert running.stderr is not None
        url = running.stderr.readline().removeprefix("open ").strip()
        while json.loads(urlopen(f"{url}state.json", timeout=300).read())["number"] < 1:
            assert running.poll() is None
        jpeg = urlopen(f"{url}picture", timeout=300).read()
        assert cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_UNCHANGED).shape == SHOWN_SIZE
        running.send_signal(signal.SIGINT)
        printed, _ = running.communicate(timeout=300)
    assert (running.returncode, "focus" in printed) == (130, True)
