"""Pictures of a straight needle's bevelled tip, drawn by the tests' own renderer, with the tip's exact pixel."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from labrig.vision.plane import Insertion
from labrig.vision.template import TipTemplate
from tests.vision.rendering import RenderedBench, RenderedGel, RenderedLens, RenderedNeedle

PLAIN = RenderedGel(bubbles=0, tracks_mm=(), unevenness=0.1)
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
def bench() -> RenderedBench:
    """Return a camera that looks straight down through a lens without distortion."""
    return RenderedBench(
        RenderedLens(
            width=640,
            height=480,
            centre_px=(320.0, 240.0),
            k1=0.0,
            k2=0.0,
            tilt_rad=0.0,
            origin_px=(200.0, 240.0),
        )
    )


@cache
def tip(heading_rad: float = 0.0, seed: int = 0, *, over: bool = False, gel: RenderedGel = PLAIN) -> Tip:
    """Draw a needle that heads so; at another fraction of a pixel for each seed."""
    shift = np.random.default_rng(seed).uniform(0.0, 0.5, 2)
    needle = RenderedNeedle(
        radius_mm=_STRAIGHT_MM,
        length_mm=12.0,
        heading_rad=heading_rad,
        sheath_tip_mm=(float(shift[0] - 8.0 * np.sin(heading_rad)), float(shift[1])),
        bend=1 if over else -1,
        glint=0.0 if over else 1.0,
    )
    end = np.array(needle.sheath_tip_mm) + 12.0 * np.array([np.sin(heading_rad), np.cos(heading_rad)])
    u, v = bench().lens.plane_map().to_px(end[None])[0]
    return Tip(bench().picture(needle, gel, seed), (float(u), float(v)), heading_rad)
