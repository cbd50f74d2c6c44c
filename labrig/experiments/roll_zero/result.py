"""The roll at which a needle bends towards -y, as it is clamped."""

from collections.abc import Mapping
from typing import Literal

from labrig.analysis.result import Result, Rows, Sentinel, TrialOrigin, make_origin_table


class RollZeroResult(Result):
    """Of roll zero runs: the deflections by roll, and the cosine fitted to them, None where that was refused.

    `offset_mm` is where the sheath stands aside, the constant of that fit; None in results of earlier versions.
    """

    kind: Literal["roll-zero"] = "roll-zero"
    accepted: bool
    reasons: tuple[str, ...]
    needle_id: str
    rolls_rad: tuple[float, ...]
    deflections_mm: tuple[float, ...]
    fit: dict[str, float] | None
    offset_mm: float | None = None
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None

    @property
    def tables(self) -> Mapping[str, Rows]:
        """What the result says row by row."""
        return make_origin_table(self.origins)
