"""What a terminal shows of measured curvatures."""

from collections.abc import Mapping
from typing import Any

from labrig.analysis.summary import Summary, TextTable
from labrig.text import interval, number

_HEADS = ("specimen", "gelatin %", "n", "refused", "radius mm", "SD mm", "95 % interval mm")


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the table of the paper, a row a needle and gel; of imported pictures how many were measured."""
    groups, measured = document["specimens"], document["measurements"]
    rows = tuple(
        (
            group["name"],
            f"{group['gelatin_percent']:g}",
            group["n"],
            group["refused"],
            number(group["mean_radius_mm"]),
            number(group["sd_radius_mm"]),
            interval(group["ci95_mm"]),
        )
        for group in groups
    )
    mean = f"mean of the means  {number(document['mean_radius_mm'])} mm"
    return Summary(
        (TextTable(_HEADS, rows), mean) if rows else (),
        {
            **{f"{group['name']}: mean radius mm": group["mean_radius_mm"] for group in groups},
            "pictures": len(measured),
            "shaft and tip found": sum(bool(each["found"]) for each in measured),
            "radius accepted": sum(bool(each["accepted"]) for each in measured),
        },
    )
