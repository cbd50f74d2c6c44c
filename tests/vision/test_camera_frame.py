"""Test frames: pictures that carry the camera with which they were taken."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from labrig.vision.calibration_file import CameraInUse, encode_frame, read_common_camera
from labrig.vision.picture import read_picture

IMAGE = np.arange(30 * 40, dtype=np.uint32).astype(np.uint8).reshape(30, 40)
CAMERA = CameraInUse(driver="uvc", device="/dev/vidé0", settings={"focus": 30, "pixel_format": "GREY"})


@pytest.mark.parametrize("image", [IMAGE, np.dstack([IMAGE, IMAGE + 1, IMAGE + 2])])
def test_a_test_frame_is_an_ordinary_picture_that_knows_its_camera(image: np.ndarray, tmp_path: Path) -> None:
    """Pixels and settings come back."""
    path = tmp_path / "frame.png"
    path.write_bytes(encode_frame(image, CAMERA))
    assert np.array_equal(read_picture(path), image)
    assert read_common_camera([path, path]) == CAMERA


def test_a_camera_is_that_of_all_pictures_or_none(tmp_path: Path) -> None:
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
