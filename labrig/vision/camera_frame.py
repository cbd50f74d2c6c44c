"""The camera with which pictures were taken, and its settings: as calibrations and test frames keep it.

Test frames are PNG files that carry the camera as JSON in a text chunk, for the calibration that is made of them.
"""

import json
from collections.abc import Sequence
from contextlib import suppress
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
from PIL import Image
from PIL.PngImagePlugin import PngInfo
from pydantic import BaseModel, ConfigDict, ValidationError

from labrig.input_file import parse_json, read_file
from labrig.vision.picture import MAX_PICTURE_BYTES, Picture

CAMERA = "camera"
"""Its key in the provenance of a calibration."""
_KEYWORD = "labrig camera"


class CameraInUse(BaseModel):
    """A camera and its settings.

    Attributes
    ----------
    driver, device : str or None
        Its driver and its address, as the rig file has them.
    settings : dict
        Every setting that the camera read back or reported.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    driver: str | None = None
    device: str | None = None
    settings: dict[str, str | int | float]

    @classmethod
    def parse(cls, document: Any) -> "CameraInUse | None":
        """Return the camera of a document; None if it describes none."""
        try:
            return cls.model_validate(document)
        except ValidationError:
            return None


UNKNOWN_CAMERA = CameraInUse(settings={})
"""A camera of which nothing is known."""


def encode_frame(image: Picture, camera: CameraInUse) -> bytes:
    """Return the content of a PNG file with a picture and its camera."""
    text, content = PngInfo(), BytesIO()
    text.add_text(_KEYWORD, json.dumps(camera.model_dump()))
    shown = image if image.ndim == 2 else cv2.cvtColor(image, cv2.COLOR_BGR2RGB)
    Image.fromarray(shown).save(content, "PNG", pnginfo=text, compress_level=1)
    return content.getvalue()


def read_common_camera(paths: Sequence[Path]) -> CameraInUse | None:
    """Return the camera that all these files carry; None if one carries none or another."""
    cameras = [_read_camera(path) for path in paths]
    return cameras[0] if cameras and all(camera == cameras[0] for camera in cameras) else None


def _read_camera(path: Path) -> CameraInUse | None:
    content = read_file(path, MAX_PICTURE_BYTES) if path.is_file() else b""
    with suppress(OSError, SyntaxError, ValueError), Image.open(BytesIO(content), formats=("PNG",)) as frame:
        return (
            CameraInUse.parse(parse_json(str(frame.info[_KEYWORD]).encode()))
            if _KEYWORD in frame.info
            else None
        )
    return None
