"""Templates on disk: a picture, and a JSON file of the same name with the pixel and heading of the tip.

The JSON file needs only `tip_px` and either `heading_rad` or `heading_deg`, so that it can be written by hand for a
picture that was cropped by hand; `labrig calibrate template` writes more.
"""

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import cv2
from pydantic import BaseModel, ConfigDict, ValidationError, model_validator

from labrig.durable import write_atomically
from labrig.errors import FileFormatError, InputError, PictureError, Problem
from labrig.input_file import read_file
from labrig.vision.calibration_file import to_json_text
from labrig.vision.picture import read_picture
from labrig.vision.plane import Insertion
from labrig.vision.tip_template import TipTemplate

_KIND, _SCHEMA_VERSION = "labrig-template", 1
_AGAIN = "make it again with `labrig calibrate template`"


class _Document(BaseModel):
    """The keys of the JSON file; other keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)

    kind: str = _KIND
    schema_version: int = _SCHEMA_VERSION
    tip_px: tuple[float, float]
    heading_rad: float | None = None
    heading_deg: float | None = None
    insertion: Insertion = "right"
    roll_rad: float = 0.0

    @model_validator(mode="after")
    def _has_one_heading(self) -> "_Document":
        if (self.heading_rad is None) == (self.heading_deg is None):
            raise ValueError("must hold either heading_rad or heading_deg")
        if self.kind != _KIND or self.schema_version != _SCHEMA_VERSION:
            raise ValueError(
                f"is {self.kind!r}, version {self.schema_version}, not {_KIND!r}, {_SCHEMA_VERSION}"
            )
        return self

    @property
    def heading(self) -> float:
        """The heading [rad]."""
        return math.radians(self.heading_deg or 0.0) if self.heading_rad is None else self.heading_rad


def template_files(path: Path) -> tuple[Path, Path]:
    """Return the picture and the JSON file of a template, from the path of either."""
    return (path.with_suffix(".png"), path) if path.suffix == ".json" else (path, path.with_suffix(".json"))


def save_template(path: Path, template: TipTemplate, provenance: Mapping[str, Any]) -> None:
    """Write a template as a PNG and a JSON file; `provenance` holds JSON values.

    Raises
    ------
    InputError
        If the name does not end in .png.
    DiskError
        If a file cannot be written.
    """
    if path.suffix != ".png":
        raise InputError(
            f"a template is written as {path.stem}.png, not as {path.name}", "end the name in .png"
        )
    document = {
        "kind": _KIND,
        "schema_version": _SCHEMA_VERSION,
        "tip_px": list(template.tip_px),
        "heading_rad": template.heading_rad,
        "insertion": template.insertion,
        "roll_rad": template.roll_rad,
        "provenance": dict(provenance),
    }
    picture = cv2.imencode(".png", template.picture)[1].tobytes()
    for file, content in zip(template_files(path), (picture, to_json_text(document).encode()), strict=True):
        write_atomically(file, content)


def load_template(path: Path) -> TipTemplate:
    """Read a template, from the path of its picture or its JSON file.

    Raises
    ------
    PictureError
        If the picture is missing, unreadable, too small or flat.
    FileFormatError
        If the JSON file is missing, malformed, of another kind, or puts the tip outside the picture.
    """
    picture_file, json_file = template_files(path)
    picture = read_picture(picture_file)
    try:
        found = _Document.model_validate_json(read_file(json_file))
    except FileNotFoundError as error:
        message = f"does not exist, and says where in {picture_file.name} the tip is"
        raise _make_format_error(json_file, message) from error
    except OSError as error:
        raise _make_format_error(json_file, f"cannot be read: {error.strerror}") from error
    except ValidationError as error:
        faults = tuple(
            Problem(" ".join((str(json_file), *map(str, fault["loc"]))), fault["msg"], _AGAIN)
            for fault in error.errors()
        )
        raise FileFormatError(faults) from error
    try:
        return TipTemplate(picture, found.tip_px, found.heading, found.insertion, found.roll_rad)
    except PictureError as error:
        raise error.reword(f"{picture_file}: {error.message}") from error
    except InputError as error:
        raise _make_format_error(json_file, error.message) from error


def _make_format_error(file: Path, message: str) -> FileFormatError:
    return FileFormatError((Problem(str(file), message, _AGAIN),))
