"""repeatability: an axis moves away and back, and pictures show whether a marker on it comes back too."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np
from pydantic import Field

from labrig.analysis.row_table import MeasuredPicture
from labrig.devices.operator import OperatorRequest
from labrig.errors import MeasurementRefusedError
from labrig.experiments import Experiment
from labrig.protocol.model import Model, PositiveMm, SpeedMmS
from labrig.protocol.sections import ExperimentProtocol
from labrig.runner.session import Session
from labrig.vision.picture import as_grey

EXPERIMENT = Experiment("repeatability", __name__, "Repeatability")
UNITS = {"u": "px", "v": "px"}


class Analysis(Model):
    """How the marker is found, and when it counts as back; `labrig reanalyze` can change this."""

    threshold: int = Field(128, ge=1, le=255, description="Pixels at least this bright are the marker.")
    max_spread_px: float = Field(2.0, gt=0, le=1000, description="Largest spread of one that is back [px].")


class Protocol(ExperimentProtocol):
    """The linear axis moves to `far_mm` and back, `visits` times."""

    experiment: Literal["repeatability"] = Field(description="Which experiment this file describes.")
    visits: int = Field(ge=2, le=1000, description="Number of moves away and back.")
    far_mm: PositiveMm = Field(description="Distance of a move [mm].")
    speed_mm_s: SpeedMmS = Field(description="Speed [mm/s].")
    analysis: Analysis = Field(default_factory=Analysis, description="How pictures are measured.")


class AttachMarker(OperatorRequest):
    """Attach the marker to the {axis} axis. Confirm that no needle is mounted, and that zero is here."""

    brings_gel = False  # an axis that moves in is not taken to be in tissue

    axis: str


def run(protocol: Protocol, session: Session) -> None:
    """Move away and back, and take a picture each time."""
    session.ask(AttachMarker("linear"))
    session.reference_axes()
    for trial in session.trials(range(protocol.visits)):
        with trial:
            session.move("linear", protocol.far_mm, protocol.speed_mm_s)
            session.move("linear", 0.0, protocol.speed_mm_s)
            session.take_picture()


def measure(picture: MeasuredPicture, protocol: Protocol) -> dict[str, float]:
    """Return the centre of the pixels that are as bright as the marker."""
    v_px, u_px = np.nonzero(as_grey(picture.image) >= protocol.analysis.threshold)
    if u_px.size == 0:
        raise MeasurementRefusedError("the marker is not in the picture", "lower analysis.threshold")
    return {"u": float(u_px.mean()), "v": float(v_px.mean())}


def conclude(protocol: Protocol, rows: Sequence[dict[str, Any]]) -> dict[str, float | bool | None]:
    """Return by how much the places spread about the first one, and whether that is little enough."""
    places = [(row["u_px"], row["v_px"]) for row in rows if row["reason"] is None]
    spread_px = max((math.dist(places[0], place) for place in places), default=None)
    return {
        "spread_px": spread_px,
        "came_back": spread_px is not None and spread_px <= protocol.analysis.max_spread_px,
    }
