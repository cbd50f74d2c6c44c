"""Calibration files and test frames: written values come back, and other files are refused."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from labrig.errors import DiskError, FileFormatError, InputError
from labrig.vision.calibration_file import (
    CameraInUse,
    encode_frame,
    load_intrinsics,
    load_plane,
    read_common_camera,
    save_intrinsics,
    save_plane,
)
from labrig.vision.gel import Gel, Layer
from labrig.vision.intrinsics import BoardWarp, Intrinsics, ViewResidual
from labrig.vision.picture import read_picture
from labrig.vision.plane import PlaneMap, Radial, Variation
from tests.disks import full_disk

LENS = Intrinsics(
    image_size=(1280, 720), fx=1400.0 + 1 / 3, fy=1401.1, cx=640.123456789012, cy=355.5,
    distortion=(-0.28, 0.1, 1e-17, -0.0005, 0.0), sigma={"fx": 0.4, "fy": None, "cx": 0.5, "cy": 0.6},
    rms_px=0.2, holdout_rms_px=None,
    views=(ViewResidual("a.png", 0.21, used=True), ViewResidual("b.png", None, used=False, reason="no board")),
    accepted=False, reasons=("2 different views",), board_warp=BoardWarp(1 / 3, -0.05, 0.02, 0.03, 0.35),
)  # fmt: skip
GEL = Gel(index=1.35, depth_mm=10.0, paper_at="surface", index_sigma=0.01,
          layers=(Layer(index="glass", thickness_mm=3.0),))  # fmt: skip
PLANE = PlaneMap(
    homography=((0.0, -0.1, 20 / 3), (0.1, 0.001, -3.0), (1e-6, 0.0, 1.0)), intrinsics=LENS,
    origin_px=(100.3, 200.7), insertion="right", image_size=(1280, 720), mm_per_px=0.0641,
    rms_mm=0.007, holdout_rms_mm=0.0071, points=3800, gel=GEL, flatness_mm=0.02,
    variations=(
        Variation(homography=np.eye(3), group="plane"),
        Variation(homography=2.0 * np.eye(3), group="lens", lens=LENS.parameters()),
        Variation(homography=3.0 * np.eye(3), group="surface", gel=Gel(index=1.36, depth_mm=10.0)),
    ),
)  # fmt: skip
PROVENANCE = {"command": "labrig calibrate intrinsics a.png", "pictures": {"a.png": "00ff"}}


@pytest.fixture
def lens_file(tmp_path):
    """Return an intrinsics file, with a plane file beside it."""
    save_plane(tmp_path / "plane.json", PLANE, PROVENANCE)
    save_intrinsics(tmp_path / "intrinsics.json", LENS, PROVENANCE)
    return tmp_path / "intrinsics.json"


@pytest.fixture
def plane_file(lens_file):
    """Return a plane file."""
    return lens_file.with_name("plane.json")


def test_lens_and_plane_come_back_to_the_last_digit(lens_file, plane_file):
    """Every number, view and reason survives the files, which hold kind, schema version and provenance."""
    assert load_intrinsics(lens_file) == LENS
    assert load_intrinsics(lens_file).fingerprint() == LENS.fingerprint()
    assert load_plane(plane_file, LENS) == PLANE
    for path, kind in ((lens_file, "labrig-intrinsics"), (plane_file, "labrig-plane")):
        document = json.loads(path.read_text())
        assert (document["kind"], document["schema_version"]) == (kind, 1)
        assert document["provenance"] == PROVENANCE
    assert LENS.to_json().items() <= json.loads(lens_file.read_text()).items()


def test_a_map_without_intrinsics_comes_back(tmp_path):
    """It is written with nulls and read without intrinsics; a radial term that was fitted with it is kept."""
    radial = Radial(centre_px=(320.0, 240.0), k_per_px2=1e-8)
    stated = PlaneMap.from_scale(5.607, (1.0, 2.0), "down")
    save_plane(tmp_path / "fitted.json", stated.change(radial=radial), {})
    save_plane(tmp_path / "plane.json", stated, {})
    assert load_plane(tmp_path / "fitted.json", None).radial == radial
    back = load_plane(tmp_path / "plane.json", None)
    assert back.intrinsics is None
    assert back.image_size is None
    assert back.to_mm([(1.0, 2.0)]) == pytest.approx(np.zeros((1, 2)))


def test_a_plane_is_bound_to_its_lens(plane_file, tmp_path):
    """A map is not read with another lens, without one, or with one where it was made without."""
    for intrinsics in (replace(LENS, fx=LENS.fx + 1e-9), None):
        with pytest.raises(InputError, match="was made with the intrinsics"):
            load_plane(plane_file, intrinsics)
    save_plane(tmp_path / "scale.json", PlaneMap.from_scale(5.0, (1.0, 2.0), "up"), {})
    with pytest.raises(InputError, match="was made with no intrinsics"):
        load_plane(tmp_path / "scale.json", LENS)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"{", r"intrinsics\.json: Invalid JSON: .* line 1 column 1"),
        (b"\xff\xfe\x00", "Invalid JSON"),
        (b"[1, 2]", "should be an object"),
        (b'{"kind": "labrig-intrinsics"}', "schema_version: Field required"),
        (b'{"kind": "labrig-intrinsics", "schema_version": 2}', "schema_version: Input should be 1"),
        (b'{"kind": "labrig-intrinsics", "schema_version": 1}', "fx: Field required"),
        (b'{"kind": "labrig-plane", "schema_version": 1}', r"json kind: is 'labrig-plane', not 'labrig-intrinsics'"),
        (None, "No such file"),
        ({"fx": "wide"}, r" fx\b"),
        ({"fx": -1.0}, r" fx\b"),
        ({"cx": float("nan")}, r" cx\b"),
        ({"distortion": [0.0] * 4}, r" distortion\.4\b"),
        ({"image_size": [1280.5, 720]}, r" image_size\.0\b"),
        ({"views": [{"image": "a.png"}]}, r" views\.0\.rms_px\b"),
    ],
)  # fmt: skip
def test_refuses_what_is_no_such_file(content, message, lens_file):
    """Torn, foreign, newer, empty and missing documents, and wrong values, are told with the place and the fault."""
    if isinstance(content, dict):
        content = json.dumps({**json.loads(lens_file.read_text()), **content}).encode()
    lens_file.unlink()
    if content is not None:
        lens_file.write_bytes(content)
    with pytest.raises(FileFormatError, match=message) as caught:
        load_intrinsics(lens_file)
    assert "kind: is" not in str(caught.value) or "calibrate intrinsics" in caught.value.hint


def test_refuses_a_plane_that_maps_to_a_line_a_folder_and_a_lens_in_place_of_a_plane(plane_file, lens_file):
    """A homography without an inverse, what is no file, and the other kind."""
    with pytest.raises(FileFormatError, match="cannot be read"):
        load_intrinsics(plane_file.parent)
    with pytest.raises(FileFormatError, match="kind: is 'labrig-intrinsics', not 'labrig-plane'"):
        load_plane(lens_file, LENS)
    document = json.loads(plane_file.read_text())
    plane_file.write_text(json.dumps({**document, "homography": [[1, 0, 0], [1, 0, 0], [0, 0, 1]]}))
    with pytest.raises(FileFormatError, match="no inverse"):
        load_plane(plane_file, LENS)


def test_a_failed_write_leaves_the_old_file(lens_file):
    """A failed write leaves the previous file unchanged, and no part of the new one."""
    before = lens_file.read_bytes()
    with full_disk(), pytest.raises(DiskError, match=r"cannot write .*intrinsics\.json: File too large"):
        save_intrinsics(lens_file, LENS, {})
    assert lens_file.read_bytes() == before
    assert {path.name for path in lens_file.parent.iterdir()} == {"intrinsics.json", "plane.json"}


IMAGE = np.arange(30 * 40, dtype=np.uint32).astype(np.uint8).reshape(30, 40)
CAMERA = CameraInUse(driver="uvc", device="/dev/vidé0", settings={"focus": 30, "pixel_format": "GREY"})


@pytest.mark.parametrize("image", [IMAGE, np.dstack([IMAGE, IMAGE + 1, IMAGE + 2])])
def test_a_test_frame_is_an_ordinary_picture_that_knows_its_camera(image, tmp_path):
    """Pixels and settings come back."""
    path = tmp_path / "frame.png"
    path.write_bytes(encode_frame(image, CAMERA))
    assert np.array_equal(read_picture(path), image)
    assert read_common_camera([path, path]) == CAMERA


def test_a_camera_is_that_of_all_pictures_or_none(tmp_path):
    """Another focus, a plain picture, one of another format, and damaged settings make it unknown."""
    path, other = tmp_path / "frame.png", tmp_path / "other.png"
    path.write_bytes(encode_frame(IMAGE, CAMERA))
    others = (
        encode_frame(IMAGE, CAMERA.model_copy(update={"settings": {"focus": 31}})),
        cv2.imencode(".png", IMAGE)[1].tobytes(),
        cv2.imencode(".jpg", IMAGE)[1].tobytes(),
        encode_frame(IMAGE, CAMERA).replace(b'"focus": 30', b'"focus": 38'),
        encode_frame(IMAGE, CAMERA)[:60],
    )
    for content in others:
        other.write_bytes(content)
        assert read_common_camera([path, other]) is None
    assert read_common_camera([]) is None
