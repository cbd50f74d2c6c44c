"""The protocol that `labrig import` writes for pictures that were taken elsewhere."""

from collections.abc import Iterator
from typing import Literal

from pydantic import Field

from labrig.protocol.model import Conflict, Line, Model, Name, PositiveMm
from labrig.protocol.sections import (
    AnalysisWindow,
    ExperimentProtocol,
    NeedleInPicture,
    Scale,
    check_radius,
    check_sheath,
)


class ImportedNeedle(Model):
    """The needle of pictures that were taken elsewhere."""

    needle_id: Name
    """Which needle; results are grouped by needle and gel."""
    diameter_mm: float = Field(gt=0, le=10)
    """Outer diameter of the needle [mm]."""
    design_radius_mm: PositiveMm | None = None
    """Radius of curvature that the needle was designed for [mm]; null if not known."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a radius that is not larger than the needle's diameter."""
        yield from check_radius(self.diameter_mm, self.design_radius_mm)


class ImportProtocol(ExperimentProtocol):
    """The protocol of a run made from loose pictures; `labrig import` writes it."""

    experiment: Literal["import"]
    """Which experiment this file describes."""
    title: Line = "Imported pictures"
    """Heading of the report."""
    needle: ImportedNeedle
    """The needle in the pictures."""
    sheath_diameter_mm: float | None = Field(None, gt=0, le=20)
    """Outer diameter of the sheath [mm]; null if the pictures show none."""
    scale: Scale | None = None
    """Millimetres by one number; null if a calibration maps the pictures."""
    analysis: AnalysisWindow
    """Which part of the shaft is fitted, and what is accepted."""

    @property
    def pictured_needle(self) -> NeedleInPicture:
        """Needle and sheath of the run."""
        return NeedleInPicture(self.needle.diameter_mm, self.sheath_diameter_mm)

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a sheath that is too narrow for the needle."""
        if self.sheath_diameter_mm is not None:
            yield from check_sheath("sheath_diameter_mm", self.sheath_diameter_mm, self.needle.diameter_mm)


Protocol = ImportProtocol
