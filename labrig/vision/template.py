"""A picture of a needle's tip, with the tip's pixel, its heading, and the pixels worth comparing.

On disk it is a picture, and a JSON file of the same name. The JSON file needs only `tip_px` and either `heading_rad` or
`heading_deg`, so that it can be written by hand for a picture that was cropped by hand; `labrig calibrate template`
writes more.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Self

import cv2
import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, TypeAdapter, model_validator

from labrig.durable import write_atomically
from labrig.errors import FileFormatError, InputError, PictureError, Problem
from labrig.text import round_down
from labrig.vision.calibration_file import to_json_text, validate_file
from labrig.vision.picture import Picture, as_grey, read_picture
from labrig.vision.plane import PICTURE_AXES, Insertion, check_frame
from labrig.vision.tip_fit import FitTemplate

LEAST_SIDE_PX = 9
# Least standard deviation of a template's grey levels: below it nothing correlates.
_LEAST_CONTRAST = 4.0
# A bright spot narrower than this share of the template's side is a glint.
_GLINT = 1 / 6
# A step of grey levels above this share of the highest step is an edge.
_EDGE = 0.3
# A pixel near the rim is not compared if its value without glints is uncertain by more than this [grey levels].
_UNSURE = 12


@dataclass(frozen=True, eq=False)
class TipTemplate:
    """A picture of a tip.

    Parameters
    ----------
    picture : ndarray of uint8, (H, W)
    tip_px : (float, float)
        Pixel of the tip (u, v) in the template.
    heading_rad : float
        Heading of the needle in the template.
    insertion : "right", "left", "up" or "down"
        Direction of the insertion in the template.
    roll_rad : float
        Roll of the bevel in the template.

    Raises
    ------
    PictureError
        For a picture that is not of 8 bits, too small, or flat.
    InputError
        For a tip outside of the picture, or a number that is not finite.
    """

    picture: Picture
    tip_px: tuple[float, float]
    heading_rad: float
    insertion: Insertion = "right"
    roll_rad: float = 0.0

    def __post_init__(self) -> None:
        grey = require_grey(self.picture)
        object.__setattr__(self, "picture", grey)
        (height, width), (u, v) = grey.shape, self.tip_px
        if min(height, width) < LEAST_SIDE_PX:
            raise PictureError(
                f"the template has {width} x {height} pixels, and {LEAST_SIDE_PX} a side is the least",
                "take a larger piece around the tip",
            )
        if self.contrast < _LEAST_CONTRAST:
            raise PictureError(
                f"the template is flat: its grey levels spread by {round_down(self.contrast, 1)}, "
                f"and {_LEAST_CONTRAST:g} is the least",
                "take a picture in which the tip is sharp and lit",
            )
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):
            raise InputError(f"the tip ({u:g}, {v:g}) px lies outside of the template, {width} x {height} px")
        if not (math.isfinite(self.heading_rad) and math.isfinite(self.roll_rad)):
            raise InputError("the template's heading or roll is not finite", "make the template again")
        check_frame(self.tip_px, self.insertion)

    @cached_property
    def plain(self) -> Picture:
        """The picture without glints."""
        return remove_glints(self.picture, min(self.picture.shape))

    @cached_property
    def coarse_fit(self) -> FitTemplate:
        """The picture without glints, prepared for the first fit, without pixels that may be glints at the rim."""
        brightest = remove_glints(self.picture, min(self.picture.shape), beyond=255)
        sure = cv2.absdiff(brightest, self.plain) <= _UNSURE
        return FitTemplate(self.plain, self.tip_px, sure, robust=False)

    @cached_property
    def close_fit(self) -> FitTemplate:
        """The picture as it is, prepared for the last fit."""
        return FitTemplate(self.picture, self.tip_px, _find_edges(self.picture), robust=True)

    @cached_property
    def contrast(self) -> float:
        """Spread of the grey levels."""
        return float(self.picture.std())

    @cached_property
    def mirrored(self) -> "TipTemplate":
        """The template of the same bevel turned over: mirrored top to bottom."""
        u, v = self.tip_px
        upside_down = -(self.heading_rad + _direction_rad(self.insertion))
        return replace(
            self,
            picture=np.ascontiguousarray(self.picture[::-1]),
            tip_px=(u, self.picture.shape[0] - 1.0 - v),
            heading_rad=wrap_angle(upside_down - _direction_rad(self.insertion)),
            roll_rad=self.roll_rad + math.pi,
        )

    def relative_to(self, insertion: Insertion) -> Self:
        """Return the same template with its heading relative to another direction of insertion."""
        turned = _direction_rad(self.insertion) - _direction_rad(insertion)
        return replace(self, heading_rad=wrap_angle(self.heading_rad + turned), insertion=insertion)

    def has_same_side(self, roll_rad: float) -> bool:
        """Return whether the bevel at this roll looks as in this template, rather than turned over."""
        return math.cos(roll_rad - self.roll_rad) >= 0.0


def cut_template(
    image: Picture,
    tip_px: tuple[float, float],
    heading_rad: float,
    *,
    side_px: int,
    insertion: Insertion,
    roll_rad: float = 0.0,
) -> TipTemplate:
    """Return the square around a tip as a template.

    Parameters
    ----------
    image : ndarray of uint8, (H, W) or (H, W, 3)
    tip_px : (float, float)
        Pixel of the tip in the picture.
    heading_rad, insertion, roll_rad
        As in `TipTemplate`.
    side_px : int
        Side of the square; an even side becomes the next odd number.

    Raises
    ------
    PictureError
        If the square does not lie in the picture, or is too small or flat for a template.
    InputError
        If a number is not finite.
    """
    grey = require_grey(image)
    if not np.isfinite(tip_px).all():
        raise InputError(f"the tip {tip_px} px is not a number", "point at a pixel of the picture")
    half_px = side_px // 2
    u, v = (round(at) for at in tip_px)
    left, top = u - half_px, v - half_px
    height, width = grey.shape
    if left < 0 or top < 0 or u + half_px >= width or v + half_px >= height:
        raise PictureError(
            f"a square of {2 * half_px + 1} px around the tip ({u}, {v}) px does not lie in the picture, "
            f"{width} x {height} px",
            "take a frame in which the tip is further from the border, or a smaller square",
        )
    square = np.ascontiguousarray(grey[top : v + half_px + 1, left : u + half_px + 1])
    return TipTemplate(square, (tip_px[0] - left, tip_px[1] - top), heading_rad, insertion, roll_rad)


def remove_glints(picture: Picture, side_px: float, beyond: int = 0) -> Picture:
    """Return a picture without bright spots narrower than a needle in a template of that side.

    The pixels beyond the rim are unknown. With `beyond` black (0) the result is the darkest possible, with white (255)
    the brightest.
    """
    width = 2 * round(0.5 * _GLINT * side_px) + 1
    wider = cv2.copyMakeBorder(picture, *(width,) * 4, cv2.BORDER_CONSTANT, value=beyond)
    opened = cv2.morphologyEx(wider, cv2.MORPH_OPEN, np.ones((width, width), np.uint8))
    return np.ascontiguousarray(opened[width:-width, width:-width], np.uint8)


def _find_edges(picture: Picture) -> NDArray[np.bool_]:
    """Return the pixels close to an edge; only these determine the place."""
    smooth = cv2.GaussianBlur(picture, (0, 0), 1.0)
    steps = cv2.morphologyEx(smooth, cv2.MORPH_GRADIENT, np.ones((3, 3), np.uint8))
    near = cv2.dilate((steps > _EDGE * float(steps.max())).astype(np.uint8), np.ones((9, 9), np.uint8))
    return np.asarray(near, np.bool_)


def _direction_rad(insertion: Insertion) -> float:
    """Return the angle of the insertion in the picture, zero to the right and positive counter-clockwise."""
    u, v = PICTURE_AXES[insertion][1]
    return math.atan2(-v, u)


def wrap_angle(angle_rad: float) -> float:
    """Return the angle between -pi and pi."""
    return math.remainder(angle_rad, 2.0 * math.pi)


def require_grey(image: Picture) -> Picture:
    """Return a picture of 8 bits in grey; raises PictureError for any other array."""
    if image.dtype != np.uint8 or image.ndim not in {2, 3} or not image.size:
        raise PictureError(
            f"a picture of {image.dtype} with shape {image.shape} cannot be searched", "use 8 bits a channel"
        )
    return as_grey(image)


_AGAIN = "make it again with `labrig calibrate template`"


class _Document(BaseModel):
    """The keys of the JSON file; other keys are ignored."""

    model_config = ConfigDict(frozen=True, extra="ignore", strict=True, allow_inf_nan=False)

    tip_px: tuple[float, float]
    heading_rad: float | None = None
    heading_deg: float | None = None
    insertion: Insertion = "right"
    roll_rad: float = 0.0

    @model_validator(mode="after")
    def _has_one_heading(self) -> "_Document":
        if (self.heading_rad is None) == (self.heading_deg is None):
            raise ValueError("must hold either heading_rad or heading_deg")
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
    found = validate_file(json_file, TypeAdapter(_Document), _AGAIN)
    try:
        return TipTemplate(picture, found.tip_px, found.heading, found.insertion, found.roll_rad)
    except PictureError as error:
        raise error.reword(f"{picture_file}: {error.message}") from error
    except InputError as error:
        raise FileFormatError((Problem(str(json_file), error.message, _AGAIN),)) from error
