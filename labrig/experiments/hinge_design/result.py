"""The result of a design: what to cut for a steering radius."""

from typing import Any, Literal

from labrig.analysis.result import Result
from labrig.needle.design_search import GridPoint


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
    equation_3: dict[str, Any]
    tolerance: dict[str, Any]
    table_1: dict[str, float] | None
    links: int | None
    measured: dict[str, Any] | None
    search: dict[str, Any]
    cells: tuple[GridPoint, ...]
