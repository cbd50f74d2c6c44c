"""The roll at which a needle bends towards -y, as it is clamped."""

import math
from collections.abc import Mapping
from typing import Any, Literal

from labrig.analysis.result import Result, Rows, Sentinel, TrialOrigin, make_origin_table
from labrig.analysis.summary import Summary
from labrig.text import number


class RollZeroResult(Result):
    """The result of a roll zero run: the deflection at each roll, and the fitted cosine; None if the fit was refused.

    `offset_mm` is the sheath's lateral offset, the constant of that fit; None in results of earlier versions.
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
        """The tables of the result."""
        return make_origin_table(self.origins)


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the zero with its uncertainty, or why there is none."""
    values = {"accepted": document["accepted"], **(document["fit"] or {})}
    return Summary(tuple(_list_lines(document)), values)


def _list_lines(document: Mapping[str, Any]) -> list[str]:
    fit = document["fit"]
    if fit is None or not document["accepted"]:
        return ["roll zero refused", *(f"  {reason}" for reason in document["reasons"])]
    zero, sd = (number(math.degrees(fit[key])) for key in ("zero_rad", "sd_rad"))
    return [f"needle {document['needle_id']} bends towards -y at {zero} degrees, SD {sd} degrees"]
