"""The result of the analysis, stored in `RUN/analysis/NNN/`."""

from collections.abc import Mapping
from typing import Literal

from labrig.analysis.result import Result, Rows
from labrig.protocol.model import Model


class Visit(Model):
    """Position of the marker after the axis came back; None if the picture does not show it."""

    trial: int
    frame: int
    u_px: float | None = None
    v_px: float | None = None


class RepeatabilityResult(Result):
    """Largest distance of the marker from its first position, and whether the protocol's limit allows it."""

    kind: Literal["repeatability"] = "repeatability"
    accepted: bool
    spread_px: float | None
    visits: tuple[Visit, ...]

    @property
    def tables(self) -> Mapping[str, Rows]:
        """The visits, written as `visits.csv`."""
        return {"visits": Rows(Visit, self.visits)}
