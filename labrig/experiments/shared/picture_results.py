"""What is known of its trial and of the run, in the result of a picture: origin, drift, refusal."""

import math

from labrig.analysis.origin import to_origin_frame
from labrig.analysis.result import Sentinel, TrialOrigin
from labrig.analysis.statistics import TWO_SIDED_95
from labrig.experiments.shared.curvature_result import PictureResult


def complete_picture(
    picture: PictureResult, origin: TrialOrigin | None, sentinel: Sentinel | None
) -> PictureResult:
    """Return a picture with its origin, and with the drift in its error bars; refused where one of the two was.

    Parameters
    ----------
    origin : TrialOrigin or None
        Of its trial; None: as for an imported picture, the origin is the sheath's end in it.
    sentinel : Sentinel or None
        The drift of the camera; None if the protocol asks for none.
    """
    update = _locate(picture, origin)
    if sentinel is not None and sentinel.accepted and sentinel.drift:
        update |= _widen(picture, sentinel.drift)
    if picture.accepted:
        refusals = [
            judged.reason
            for judged in (None if origin is None or origin.tip_mm is None else origin, sentinel)
            if judged is not None and not judged.accepted
        ]
        update |= {"accepted": False, "reason": refusals[0]} if refusals else {}
    return picture.model_copy(update=update)


def _locate(picture: PictureResult, origin: TrialOrigin | None) -> dict[str, object]:
    """Return the origin, and the needle's tip relative to it."""
    place, heading_rad = (
        (picture.sheath_tip_mm, picture.sheath_heading_rad)
        if origin is None
        else (origin.tip_mm, origin.heading_rad)
    )
    if place is None or heading_rad is None:
        return {}
    known: dict[str, object] = {"origin_mm": place, "origin_heading_rad": heading_rad}
    if picture.tip_mm is not None:
        known["tip_from_origin_mm"] = to_origin_frame(picture.tip_mm, place, heading_rad)
    return known


def _widen(picture: PictureResult, drift: float) -> dict[str, object]:
    """Return the error bars with the drift, taken as one standard deviation."""
    wider: dict[str, object] = {}
    if picture.tip_mm is not None and picture.tip_budget_mm is not None:
        wider["tip_budget_mm"] = picture.tip_budget_mm.with_drift(drift * math.hypot(*picture.tip_mm))
    if picture.radius_mm is None or picture.sigma_radius_mm is None:
        return wider
    more = drift * picture.radius_mm
    wider["sigma_radius_mm"] = math.hypot(picture.sigma_radius_mm, more)
    if picture.radius_budget_mm is not None:
        wider["radius_budget_mm"] = picture.radius_budget_mm.with_drift(more)
    if picture.radius_ci95_mm is not None:
        low, high = (
            math.hypot(end - picture.radius_mm, TWO_SIDED_95 * more) for end in picture.radius_ci95_mm
        )
        wider["radius_ci95_mm"] = (picture.radius_mm - low, picture.radius_mm + high)
    return wider
