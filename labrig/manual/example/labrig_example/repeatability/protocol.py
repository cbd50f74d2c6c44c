"""The keys of the protocol, with unit, limits and description."""

from typing import Literal

from pydantic import Field

from labrig.protocol.model import Line, Model, PositiveMm, SpeedMmS
from labrig.protocol.sections import ExperimentProtocol


class MarkerAnalysis(Model):
    """How the marker is found, and when it counts as back; `labrig reanalyze` can change this."""

    threshold: int = Field(
        128, ge=1, le=255, description="Pixels at least this bright are the marker [grey level]."
    )
    max_spread_px: float = Field(
        2.0, gt=0, le=1000, description="Largest spread of a marker that has come back [px]."
    )


class RepeatabilityProtocol(ExperimentProtocol):
    """The linear axis moves to `far_mm` and back, `visits` times."""

    experiment: Literal["repeatability"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Repeatability", description="Heading of the report.")
    visits: int = Field(ge=2, le=1000, description="Number of moves away and back.")
    far_mm: PositiveMm = Field(description="Distance of a move [mm].")
    speed_mm_s: SpeedMmS = Field(description="Speed [mm/s].")
    analysis: MarkerAnalysis = Field(default_factory=MarkerAnalysis, description="How pictures are measured.")
