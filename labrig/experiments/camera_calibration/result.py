"""What a camera calibration found."""

from typing import Any, Literal

from labrig.analysis.result import Point, Result


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


RunResult = CalibrationResult
