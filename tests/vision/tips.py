"""Pictures of a straight needle's bevelled tip, drawn by the tests' own renderer, with the tip's exact pixel."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import Insertion
from labrig.vision.template import TipTemplate
from tests.vision.renderer import Camera, Gel, Needle, Photo

CAMERA = Camera((640, 480), 1800.0, (320.0, 240.0), (0.0,) * 5, 115.4, 0.0, origin_px=(200.0, 240.0))
PLAIN = Gel(None, CAMERA, Photo(0.05, fall=0.05), bubbles=0, tracks_mm=())
_STRAIGHT_MM = 1e9


@dataclass(frozen=True)
class Tip:
    """A picture with the true pixel and heading of its tip."""

    picture: NDArray[np.uint8]
    px: tuple[float, float]
    heading_rad: float

    def template(self, half_px: int = 20, insertion: Insertion = "right") -> TipTemplate:
        """Return the square around the tip as a template."""
        u, v = (round(at) for at in self.px)
        square = self.picture[v - half_px : v + half_px + 1, u - half_px : u + half_px + 1]
        tip = (self.px[0] - u + half_px, self.px[1] - v + half_px)
        return TipTemplate(square, tip, self.heading_rad, insertion)


@cache
def tip(heading_rad: float = 0.0, seed: int = 0, *, over: bool = False, gel: Gel = PLAIN) -> Tip:
    """Draw a needle that heads so, positive upwards; at another fraction of a pixel for each seed."""
    up, right = np.random.default_rng(seed).uniform(0.0, 0.5, 2)
    needle = Needle(
        _STRAIGHT_MM,
        12.0,
        (float(right), float(8.0 * np.sin(heading_rad) - up)),
        -heading_rad,
        -1 if over else 1,
        line=0.0 if over else 163.0,
    )
    u, v = CAMERA.to_px([needle.tip_mm])[0]
    return Tip(gel.take(seed, needle=needle), (float(u), float(v)), heading_rad)
