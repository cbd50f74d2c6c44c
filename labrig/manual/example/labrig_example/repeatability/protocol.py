"""The protocol: what stands in the YAML file, with units, limits and a sentence for each key."""

from typing import Literal

from pydantic import Field

from labrig.protocol.model import Line, Model, PositiveMm, SpeedMmS
from labrig.protocol.sections import ExperimentProtocol


class MarkerAnalysis(Model):
    """How the marker is found, and when it has come back; `labrig reanalyze` can change it."""

    threshold: int = Field(
        128, ge=1, le=255, description="Pixels as bright as this are the marker [grey level]."
    )
    max_spread_px: float = Field(
        2.0, gt=0, le=1000, description="Spread beyond which it has not come back [px]."
    )


class RepeatabilityProtocol(ExperimentProtocol):
    """The linear axis goes to `far_mm` and back, `visits` times."""

    experiment: Literal["repeatability"] = Field(description="Which experiment this file describes.")
    title: Line = Field("Repeatability", description="Heading of the report.")
    visits: int = Field(ge=2, le=1000, description="How often the axis goes and comes back.")
    far_mm: PositiveMm = Field(description="How far it goes [mm].")
    speed_mm_s: SpeedMmS = Field(description="How fast [mm/s].")
    analysis: MarkerAnalysis = Field(default_factory=MarkerAnalysis, description="How pictures are measured.")
