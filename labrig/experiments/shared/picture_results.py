"""Apply what is known of a trial or a run to the results of its pictures: origin, refusal, drift."""

import math
from collections.abc import Sequence

import numpy as np

from labrig.analysis.origin import to_origin_frame
from labrig.analysis.result import Sentinel, TrialOrigin
from labrig.experiments.shared.curvature_result import PictureResult

_TWO_SIDED_95 = 1.96


def refuse_by_origin(
    results: Sequence[PictureResult], origins: Sequence[TrialOrigin]
) -> tuple[PictureResult, ...]:
    """Return the pictures; those of a trial whose origin was refused are refused too."""
    reasons = {
        origin.trial: origin.reason for origin in origins if origin.tip_mm is not None and not origin.accepted
    }
    return tuple(
        picture.model_copy(update={"accepted": False, "reason": reasons[picture.trial]})
        if picture.trial in reasons and picture.accepted
        else picture
        for picture in results
    )


def add_origins(
    results: Sequence[PictureResult], origins: Sequence[TrialOrigin]
) -> tuple[PictureResult, ...]:
    """Return the pictures with their origins, and with the needle's tip relative to them.

    The origin is that of the trial; for an imported picture it is the sheath's end in that picture.
    """
    by_trial = {origin.trial: origin for origin in origins}
    return tuple(
        _add_origin(picture, None if picture.trial is None else by_trial.get(picture.trial))
        for picture in results
    )


def _add_origin(picture: PictureResult, origin: TrialOrigin | None) -> PictureResult:
    place, heading_rad = (
        (picture.sheath_tip_mm, picture.sheath_heading_rad)
        if origin is None
        else (origin.tip_mm, origin.heading_rad)
    )
    if place is None or heading_rad is None:
        return picture
    known: dict[str, object] = {"origin_mm": place, "origin_heading_rad": heading_rad}
    if picture.tip_mm is not None:
        known["tip_from_origin_mm"] = to_origin_frame(picture.tip_mm, place, heading_rad)
    return picture.model_copy(update=known)


def add_drift(results: Sequence[PictureResult], sentinel: Sentinel | None) -> tuple[PictureResult, ...]:
    """Return the pictures with the drift in their error bars; if the sentinel was refused, so are they."""
    if sentinel is None:
        return tuple(results)
    if not sentinel.accepted:
        refused = {"accepted": False, "reason": sentinel.reason}
        return tuple(
            picture.model_copy(update=refused) if picture.accepted else picture for picture in results
        )
    return tuple(_widen(picture, sentinel.drift or 0.0) for picture in results)


def _widen(picture: PictureResult, drift: float) -> PictureResult:
    """Return a picture whose error bars include the drift, taken as one standard deviation."""
    if not drift:
        return picture
    update: dict[str, object] = {}
    if picture.tip_mm is not None and picture.tip_budget_mm is not None:
        update["tip_budget_mm"] = picture.tip_budget_mm.with_drift(drift * math.hypot(*picture.tip_mm))
    if picture.radius_mm is None or picture.sigma_radius_mm is None:
        return picture.model_copy(update=update)
    more = drift * picture.radius_mm
    update["sigma_radius_mm"] = float(np.hypot(picture.sigma_radius_mm, more))
    if picture.radius_budget_mm is not None:
        update["radius_budget_mm"] = picture.radius_budget_mm.with_drift(more)
    if picture.radius_ci95_mm is not None:
        low, high = (abs(end - picture.radius_mm) for end in picture.radius_ci95_mm)
        reach = _TWO_SIDED_95 * more
        update["radius_ci95_mm"] = (
            picture.radius_mm - float(np.hypot(low, reach)),
            picture.radius_mm + float(np.hypot(high, reach)),
        )
    return picture.model_copy(update=update)
