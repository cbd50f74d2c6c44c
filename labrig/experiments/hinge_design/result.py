"""The result of a design: what to cut for a steering radius, by equation (3) and on our own contour."""

from collections.abc import Iterator, Mapping
from typing import Literal

import pandas as pd

from labrig.analysis.result import Result
from labrig.experiments.hinge_design.protocol import DesignTolerances
from labrig.needle.design_search import STEEPEST_CUT_DEG
from labrig.needle.equations import EQUATION_3, FIT_SD, RadiusTolerance, RotationPlane
from labrig.needle.rotation_search import GridPoint
from labrig.needle.tube import TABLE_1
from labrig.protocol.design_file import Basis, Tube
from labrig.protocol.model import Model
from labrig.text import number


class Searched(Model):
    """The answer of the search on our contour; if it has none, its numbers are None and `reason` is a sentence.

    `fit` is the plane of the form of equation (3) through the searched grid.
    """

    fit: RotationPlane
    beta_cut_deg: float | None = None
    beta_rot_deg: float | None = None
    beta_a_deg: float | None = None
    beta_b_deg: float | None = None
    radius_mm: float | None = None
    tolerance: RadiusTolerance | None = None
    inside_grid: bool | None = None
    reason: str | None = None


class MeasuredAnswer(Model):
    """What the radius of a measured needle says: its rotation, and the clearance by equation (3)."""

    radius_mm: float
    beta_rot_deg: float
    beta_cut_deg: float
    clearance_mm: float


class DesignStudy(Model):
    """Both answers: `beta_cut_deg` and `tolerance` are those of equation (3), `search` that of our own contour.

    `accepted`: there is something to cut, by equation (3) or, for a tube that it does not cover, by our contour.
    """

    accepted: bool
    beta_cut_deg: float
    beta_rot_deg: float
    radius_mm: float
    clearance_mm: float
    tube: Tube
    equation_3: RotationPlane = EQUATION_3
    tolerances: DesignTolerances
    tolerance: RadiusTolerance
    measured: MeasuredAnswer | None
    search: Searched
    cells: tuple[GridPoint, ...]

    @property
    def basis(self) -> Basis:
        """What the design is based on: equation (3) if it covers the tube, otherwise our contour."""
        return "equation (3)" if self.tube.is_papers else "our contour"

    @property
    def is_table_1(self) -> bool:
        """Whether this is the needle of table I."""
        return TABLE_1.is_asked(self.tube, self.clearance_mm, self.radius_mm)


class DesignResult(Result, DesignStudy):
    """The result of a design run."""

    kind: Literal["design"] = "design"

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The searched grid: a row for each cell, with the values of both planes."""
        grid = pd.DataFrame([vars(cell) for cell in self.cells])
        grid["beta_rot_deg"] = grid["beta_a_deg"] + grid["beta_b_deg"]
        for name, plane in (("plane_deg", self.search.fit), ("equation_3_deg", self.equation_3)):
            grid[name] = [plane.beta_rot_deg(cell.beta_cut_deg, cell.clearance_mm) for cell in self.cells]
        return {"grid": grid.assign(residual_deg=grid["beta_rot_deg"] - grid["plane_deg"])}


RunResult = DesignResult


def list_findings(study: DesignStudy) -> Iterator[str]:
    """Yield the answers in sentences."""
    search, wanted = study.search, f"for a radius of {study.radius_mm:g} mm"
    if study.basis == "equation (3)":
        yield (
            f"Cut at an inclination of {number(study.beta_cut_deg, 2)} degrees, with a clearance of "
            f"{study.clearance_mm:g} mm, {wanted} (equation 3 of the paper)."
        )
        yield _tell_range(study, study.equation_3, study.tolerance)
        yield (
            f"Two adjacent hinges turn {number(study.beta_rot_deg, 2)} degrees together. "
            + (f"There is no second answer: {search.reason}" if search.reason else _tell_contour(search))
            + "."
        )
    elif search.reason is None and search.tolerance is not None:
        yield (
            f"{_tell_contour(search)}, {wanted} with a clearance of {study.clearance_mm:g} mm; equation (3), which "
            f"was fitted to another tube, for {number(study.beta_cut_deg, 2)} degrees."
        )
        yield _tell_range(study, search.fit, search.tolerance)
    else:
        yield f"There is nothing to cut {wanted}: {search.reason}."
    if study.is_table_1:
        yield (
            f"Table I of the paper has {TABLE_1.beta_cut_deg} degrees, where its equation (3) gives "
            f"{number(study.beta_cut_deg, 2)}; the rounding of its coefficients can explain that."
        )
    if (measured := study.measured) is not None:
        yield (
            f"The radius that the protocol gives as measured, {measured.radius_mm:g} mm, is a rotation of "
            f"{number(measured.beta_rot_deg, 2)} degrees. Cut at {number(measured.beta_cut_deg, 2)} degrees, that "
            f"takes an effective clearance of {number(measured.clearance_mm, 4)} mm by equation (3)."
        )


def _tell_contour(search: Searched) -> str:
    return f"Our contour, labrig's own drawing, would take an inclination of {number(search.beta_cut_deg, 2)} degrees"


def _tell_range(study: DesignStudy, plane: RotationPlane, radius: RadiusTolerance) -> str:
    """Return the worst cases of the radius, and what they allow for."""
    high_mm, laser = "more" if radius.high_mm is None else number(radius.high_mm, 2), study.tolerances
    return (
        f"A radius of {number(radius.low_mm, 2)} to {high_mm} mm is expected, if the laser keeps the clearance to ± "
        f"{laser.clearance_mm:g} mm and the inclination to ± {laser.cut_deg:g} degrees, and the hinges turn as "
        f"{study.basis} says to ± {number(FIT_SD * plane.rmse_deg, 2)} degrees, twice the rms residual of its fit."
    )


def list_warnings(study: DesignStudy) -> Iterator[str]:
    """Yield what limits the answers."""
    if not study.tube.is_papers:
        yield "Equation (3) was fitted to a tube of 1.2 and 0.7 mm; for this one only our contour was searched."
    if study.search.inside_grid is False:
        yield f"The inclination is beyond the searched grid, which ends at {STEEPEST_CUT_DEG:g} degrees."
    yield "Our contour is not the paper's, whose figure 2 is not in its text: it shows trends, and is not for cutting."
