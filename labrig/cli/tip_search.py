"""Finds the tip in a picture, for `labrig measure tip`."""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from labrig.analysis.calibration import list_not_in_interval
from labrig.vision.error_budget import PlaceErrors, budget_place
from labrig.vision.mask import Mask
from labrig.vision.picture import read_picture, require_size
from labrig.vision.plane import PlaneMap
from labrig.vision.tip import TIP_SIGMA_PX, locate_tip
from labrig.vision.tip_template import TipTemplate


@dataclass(frozen=True)
class TipSearch:
    """What is known of the tip: its template, perhaps heading and place, and a mask of pixels without it."""

    template: TipTemplate
    heading_deg: float | None
    near_px: tuple[float, float] | None
    region_px: float
    mask: Mask | None


def search_tip(path: Path, plane: PlaneMap, search: TipSearch) -> dict[str, object]:
    """Return the tip in a picture, in pixels and mm, with its error budget and what that leaves out.

    Light and roll are not in it: they change the tip's look against that of the template by what no picture tells.

    Raises
    ------
    PictureError
        When the picture cannot be read, is smaller than the template, or not of the plane map's size.
    InputError
        When heading or place is not a number.
    """
    image = read_picture(path)
    if plane.image_size is not None:
        require_size(image, plane.image_size, "the plane map")
    heading_rad = None if search.heading_deg is None else math.radians(search.heading_deg)
    fix = locate_tip(
        image,
        search.template,
        near_px=search.near_px,
        heading_rad=heading_rad,
        region_px=search.region_px,
        mask=None if search.mask is None else search.mask.find_masked(path.name, image),
    )
    if fix.tip_px is None:
        return {**fix.to_json(), "tip_mm": None, "tip_budget_mm": None, "not_in_interval": []}
    tip_mm = plane.to_mm(np.array([fix.tip_px]))[0].tolist()
    budget = budget_place(plane, fix.tip_px, PlaceErrors(fit_mm=TIP_SIGMA_PX * plane.mm_per_px))
    return {
        **fix.to_json(),
        "tip_mm": tip_mm,
        "tip_budget_mm": budget.to_json(),
        "not_in_interval": list(list_not_in_interval(plane, [budget])),
    }
