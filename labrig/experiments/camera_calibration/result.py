"""What a camera calibration found."""

from collections.abc import Mapping
from typing import Any, Literal

from labrig.analysis.result import Point, Result
from labrig.analysis.summary import Summary


class CalibrationResult(Result):
    """The result of a camera calibration; `intrinsics` and `plane` are None if they could not be found.

    `corners` holds the pixels (u, v) of the board's corners in each picture that was used, for the map of
    coverage.
    """

    kind: Literal["calibration"] = "calibration"
    accepted: bool
    reasons: tuple[str, ...]
    intrinsics: dict[str, Any] | None
    plane: dict[str, Any] | None

    corners: dict[str, tuple[Point, ...]]


_LENS_PX = ("fx", "fy", "cx", "cy", "rms_px", "holdout_rms_px")
_PLANE = ("mm_per_px", "rms_mm", "holdout_rms_mm")


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the verdict and its reasons."""
    lens, plane = document["intrinsics"] or {}, document["plane"] or {}
    verdict = "calibration accepted" if document["accepted"] else "calibration refused"
    return Summary(
        (verdict, *(f"  {reason}" for reason in document["reasons"])),
        {
            "accepted": document["accepted"],
            "views used": sum(bool(view["used"]) for view in lens.get("views", ())),
            **{f"lens: {name}": lens.get(name) for name in _LENS_PX},
            **{f"plane: {name}": plane.get(name) for name in _PLANE},
        },
    )
