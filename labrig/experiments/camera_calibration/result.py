"""What a camera calibration found."""

from collections.abc import Mapping
from typing import Any, Literal

from labrig.analysis.result import Point, Result, Summary


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


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the verdict and its reasons, and what the scale implies."""
    lens, plane = document["intrinsics"], document["plane"]
    if lens is None or plane is None:
        return "The camera could not be calibrated.", *document["reasons"]
    used = sum(view["used"] for view in lens["views"])
    word = "Accepted" if document["accepted"] else "Refused"
    found = (
        f"{word}: {used} photographs of the board, fx {lens['fx']:.2f} px; graph paper maps to mm within "
        f"{plane['rms_mm']:.3f} mm rms."
    )
    return found, *document["reasons"], *filter(None, (plane.get("view"),))


RunResult = CalibrationResult
