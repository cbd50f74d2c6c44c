"""A design file: the hinge that was cut, its radius with tolerance, and how they were computed.

Runs of protocols/design.yaml write it as JSON. JSON is YAML, so the usual reader reads it and its problems
have a line too. It is here and not in `needle` because protocols name it, and code that reads protocols, such as the
simulated world, must not depend on how a hinge is computed.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal, TypeAlias

from pydantic import Field

from labrig.protocol.model import Conflict, Model, PositiveMm
from labrig.protocol.yaml_file import load_yaml_model

Basis: TypeAlias = Literal["equation (3)", "our contour"]


class Tube(Model):
    """The tube that the needle's tip is cut from."""

    outer_diameter_mm: float = Field(ge=0.2, le=10)
    """Outer diameter of the tube [mm]."""
    inner_diameter_mm: float = Field(ge=0.1, le=9.9)
    """Inner diameter of the tube [mm]."""
    link_length_mm: float = Field(ge=0.2, le=100)
    """Length of a link, from hinge to hinge [mm]."""

    @property
    def is_papers(self) -> bool:
        """Whether it has the section of the paper's tube, to which equation (3) was fitted; links may be longer."""
        paper = PAPER_TUBE
        return (self.outer_diameter_mm, self.inner_diameter_mm) == (
            paper.outer_diameter_mm,
            paper.inner_diameter_mm,
        )

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a bore that leaves no wall."""
        if self.inner_diameter_mm >= self.outer_diameter_mm:
            message = (
                f"inner_diameter_mm is {self.inner_diameter_mm:g}, must be below outer_diameter_mm, "
                f"{self.outer_diameter_mm:g}"
            )
            yield Conflict("inner_diameter_mm", message, "the two may have been given the wrong way round")


PAPER_TUBE = Tube(outer_diameter_mm=1.2, inner_diameter_mm=0.7, link_length_mm=3.0)
"""The tube of table I."""


class NeedleDesign(Model):
    """A design as other rooms use it: diameter, and the radius with its worst cases."""

    kind: Literal["labrig-needle-design"]
    """Which kind of file this is."""
    schema_version: Literal[1]
    """Version of this file format; a higher one needs a newer labrig."""
    tube: Tube
    """The tube that the needle's tip is cut from."""
    clearance_mm: float = Field(gt=0, le=1)
    """Width that the laser cuts [mm]."""
    beta_cut_deg: float = Field(ge=0, le=90)
    """Inclination of the cut [degrees]."""
    radius_mm: PositiveMm
    """Steering radius that the hinge is cut for [mm]."""
    radius_low_mm: PositiveMm
    """Smallest radius by the laser's tolerances and the fit's error [mm]."""
    radius_high_mm: float = Field(gt=0)
    """Largest radius by the laser's tolerances and the fit's error [mm]."""
    basis: Basis
    """Model by which inclination and tolerance were computed."""
    provenance: dict[str, Any]
    """Code version, packages, host and command line."""

    def conflicts(self) -> Iterator[Conflict]:
        """Yield a radius outside its own tolerance."""
        low_mm, high_mm = self.radius_low_mm, self.radius_high_mm
        if not low_mm <= self.radius_mm <= high_mm:
            message = (
                f"radius_mm is {self.radius_mm:g}, must be within its tolerance, {low_mm:g} to {high_mm:g}"
            )
            yield Conflict("radius_mm", message, "write the file again: labrig run protocols/design.yaml")


def load_design(path: Path) -> NeedleDesign:
    """Read a design file.

    Raises
    ------
    FileFormatError
        When it is missing, of another kind, newer than this program, or lacks a value; with line and hint.
    """
    return load_yaml_model(path, NeedleDesign)
