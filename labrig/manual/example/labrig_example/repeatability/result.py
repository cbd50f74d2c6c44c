"""What the analysis found, as it is stored in `RUN/analysis/NNN/`."""

from collections.abc import Mapping
from typing import Literal

from labrig.analysis.result import Result, Rows
from labrig.protocol.model import Model


class Visit(Model):
    """Where the marker stood when the axis had come back; None where the picture does not show it."""

    trial: int
    frame: int
    u_px: float | None = None
    v_px: float | None = None


class RepeatabilityResult(Result):
    """How far the marker stood from its first place at most, and whether that is within the protocol's limit."""

    kind: Literal["repeatability"] = "repeatability"
    accepted: bool
    spread_px: float | None
    visits: tuple[Visit, ...]

    @property
    def tables(self) -> Mapping[str, Rows]:
        """The visits, row by row: written as `visits.csv`."""
        return {"visits": Rows(Visit, self.visits)}
