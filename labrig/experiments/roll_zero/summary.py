"""What a terminal shows of a roll zero."""

import math
from collections.abc import Mapping
from typing import Any

from labrig.analysis.summary import Summary
from labrig.text import number


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the zero with its uncertainty, or why there is none."""
    values = {"accepted": document["accepted"], **(document["fit"] or {})}
    return Summary(tuple(_lines(document)), values)


def _lines(document: Mapping[str, Any]) -> list[str]:
    fit = document["fit"]
    if fit is None or not document["accepted"]:
        return ["roll zero refused", *(f"  {reason}" for reason in document["reasons"])]
    zero, sd = (number(math.degrees(fit[key])) for key in ("zero_rad", "sd_rad"))
    return [f"needle {document['needle_id']} bends towards -y at {zero} degrees, SD {sd} degrees"]
