"""The protocol of a design of the needle's hinges."""

from typing import Literal

from pydantic import Field

from labrig.protocol.design_file import PAPER_TUBE, Tube
from labrig.protocol.model import Line, Model, PositiveMm
from labrig.protocol.sections import Criterion, ExperimentProtocol


class DesignTolerances(Model):
    """The tolerances of laser cutting."""

    clearance_mm: float = Field(0.003, ge=0, le=0.05)
    """How sure the width of the cut is, plus or minus [mm]."""
    cut_deg: float = Field(0.1, ge=0, le=10)
    """How sure the inclination is, plus or minus [degrees]."""


class MeasuredNeedle(Model):
    """A measured needle of the same tube; its radius gives its effective clearance."""

    radius_mm: PositiveMm
    """Radius that was measured [mm]."""
    beta_cut_deg: float | None = Field(None, ge=0, le=90)
    """Inclination that it was cut at [degrees]; null: as equation (3) says."""


class DesignProtocol(ExperimentProtocol):
    """Section III of the paper: what to cut for a steering radius. It moves no rig.

    The limits of the contour and of the equations are checked by `study`, because only `needle` knows them.
    """

    experiment: Literal["design"]
    """Which experiment this file describes."""
    title: Line = "Design of the hinges"
    """Heading of the report."""
    tube: Tube = PAPER_TUBE
    """The tube that the needle's tip is cut from."""
    radius_mm: PositiveMm
    """Steering radius wanted [mm]."""
    clearance_mm: float = Field(gt=0, le=1)
    """Width that the laser cuts [mm]."""
    tolerances: DesignTolerances = DesignTolerances()
    """The tolerances of laser cutting."""
    grid_points: int = Field(7, ge=3, le=25)
    """Points of the searched grid, along each of its two sides."""
    measured: MeasuredNeedle | None = None
    """A needle that was measured, for its effective clearance; null if none was."""

    @property
    def criterion(self) -> Criterion:
        """The radius."""
        return Criterion("radius_mm")


Protocol = DesignProtocol
