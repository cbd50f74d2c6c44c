"""What a camera calibration found."""

from collections.abc import Mapping
from typing import Any, Literal

from labrig.analysis.result import Point, Result, Summary
from labrig.experiments.camera_calibration.protocol import Board, GraphPaper
from labrig.protocol.model import Model


class CalibrationSettings(Model):
    """What was photographed."""

    board: Board
    plane: GraphPaper


class CalibrationResult(Result):
    """The result of a camera calibration; `intrinsics` and `plane` are None if they could not be found.

    `corners` holds the pixels (u, v) of the board's corners in each picture that was used, for the map of
    coverage.
    """

    kind: Literal["calibration"] = "calibration"
    settings: CalibrationSettings
    accepted: bool
    reasons: tuple[str, ...]
    intrinsics: dict[str, Any] | None
    plane: dict[str, Any] | None

    corners: dict[str, tuple[Point, ...]]


_LENS_PX = ("fx", "fy", "cx", "cy", "rms_px", "holdout_rms_px")
_PLANE = ("mm_per_px", "rms_mm", "holdout_rms_mm")


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the verdict and its reasons, and what the scale implies."""
    lens, plane = document["intrinsics"] or {}, document["plane"] or {}
    verdict = "calibration accepted" if document["accepted"] else "calibration refused"
    return Summary(
        (verdict, *(f"  {reason}" for reason in document["reasons"]), *filter(None, (plane.get("view"),))),
        {
            "accepted": document["accepted"],
            "views used": sum(bool(view["used"]) for view in lens.get("views", ())),
            **{f"lens: {name}": lens.get(name) for name in _LENS_PX},
            **{f"plane: {name}": plane.get(name) for name in _PLANE},
        },
    )


RunResult = CalibrationResult
