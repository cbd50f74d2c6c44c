"""The result of a design: what to cut for a steering radius."""

from typing import Annotated, Any, Literal

from pydantic import ConfigDict, FiniteFloat

from labrig.analysis.result import Result, ResultPart, require_part
from labrig.needle.design_search import GridPoint


class _Plane(ResultPart):
    a: FiniteFloat
    b: FiniteFloat
    c: FiniteFloat
    rmse_deg: FiniteFloat


class _Fit(_Plane):
    model_config = ConfigDict(extra="forbid")


class _PaperPlane(_Plane):
    same_tube: bool


class _Slopes(ResultPart):
    radius_mm: tuple[FiniteFloat | None, FiniteFloat | None]
    radius_mm_per_clearance_mm: FiniteFloat | None
    radius_mm_per_cut_deg: FiniteFloat | None


class _Tolerance(_Slopes):
    clearance_mm: FiniteFloat
    cut_deg: FiniteFloat


class _PrintedNeedle(ResultPart):
    beta_cut_deg: FiniteFloat
    beta_rot_deg: FiniteFloat


class _MeasuredNeedle(_PrintedNeedle):
    radius_mm: FiniteFloat
    clearance_mm: FiniteFloat | None
    search_clearance_mm: FiniteFloat | None


class _Search(ResultPart):
    beta_cut_deg: FiniteFloat | None
    beta_rot_deg: FiniteFloat | None
    beta_a_deg: FiniteFloat | None
    beta_b_deg: FiniteFloat | None
    radius_mm: FiniteFloat | None
    tolerance: _Slopes | None
    inside_grid: bool | None
    reason: str | None
    fit: _Fit


class DesignResult(Result):
    """The result of a design run: the document that `labrig design --json` prints too, and the searched grid.

    `beta_cut_deg` and `tolerance` are those of equation (3); `search` holds the answer of our own contour, or the
    reason why it cannot give the radius. `accepted`: there is something to cut, by equation (3) or, for a tube that it
    does not cover, by our contour.
    """

    kind: Literal["design"] = "design"
    accepted: bool = True
    beta_cut_deg: float
    beta_rot_deg: float
    radius_mm: float
    clearance_mm: float
    tube: dict[str, float]
    equation_3: Annotated[dict[str, Any], require_part(_PaperPlane)]
    tolerance: Annotated[dict[str, Any], require_part(_Tolerance)]
    table_1: Annotated[dict[str, float], require_part(_PrintedNeedle)] | None
    links: int | None
    measured: Annotated[dict[str, Any], require_part(_MeasuredNeedle)] | None
    search: Annotated[dict[str, Any], require_part(_Search)]
    cells: tuple[GridPoint, ...]


RunResult = DesignResult
