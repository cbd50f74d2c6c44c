"""The result of measuring the curvature of needles, picture by picture and gel by gel."""

from collections.abc import Mapping
from typing import Any, Literal

import pandas as pd

from labrig.analysis.result import (
    Point,
    Result,
    Sentinel,
    Summary,
    TextTable,
    TrialOrigin,
    make_origin_table,
    tabulate,
)
from labrig.protocol.model import Model
from labrig.text import interval, number
from labrig.vision.curvature import CurvatureMeasurement, CurvatureSettings


class PictureResult(CurvatureMeasurement):
    """One picture: its trial, and its measurement; unknown and refused values are None.

    `origin_mm` and `origin_heading_rad` are those of its trial, found from the sheath; `tip_from_origin_mm` is the
    needle's tip in their frame, (y, z). All other points are in the plane's frame. `true_radius_mm` is the radius that
    a simulated world drew for its trial.
    """

    frame: int
    image: str
    role: str
    trial: int | None
    specimen: str | None
    gelatin_percent: float | None
    hole: int | None
    needle_id: str | None
    insertion_mm: float | None
    origin_mm: Point | None = None
    origin_heading_rad: float | None = None
    tip_from_origin_mm: Point | None = None
    true_radius_mm: float | None = None


class SpecimenResult(Model):
    """One needle in one gel: `n` radii of final pictures, their mean, sample SD and its 95 % interval.

    In a simulated world `true_mean_radius_mm` is the mean of all radii drawn for it, those of refused pictures too, so
    that refusing difficult pictures cannot flatter the mean; `worst_error_mm` is the largest error of a single one.
    """

    name: str
    needle_id: str
    gelatin_percent: float
    trials: int
    n: int
    mean_radius_mm: float | None
    sd_radius_mm: float | None
    ci95_mm: Point | None
    refused: int
    refused_reasons: tuple[str, ...]
    without_final_picture: int
    true_mean_radius_mm: float | None = None
    worst_error_mm: float | None = None

    @property
    def error_of_mean_mm(self) -> float | None:
        """The mean less that of the drawn radii; None if either is not known."""
        if self.mean_radius_mm is None or self.true_mean_radius_mm is None:
            return None
        return self.mean_radius_mm - self.true_mean_radius_mm


class CurvatureResult(Result):
    """The result of a steerability run or of imported pictures.

    `not_in_interval` lists the sources of error that an interval leaves out.
    """

    kind: Literal["curvature"] = "curvature"
    settings: CurvatureSettings
    specimens: tuple[SpecimenResult, ...]
    mean_radius_mm: float | None
    measurements: tuple[PictureResult, ...]
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None
    not_in_interval: tuple[str, ...] = ()

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables of the result."""
        tables: dict[str, pd.DataFrame] = {
            "measurements": tabulate(PictureResult, self.measurements),
            "specimens": tabulate(SpecimenResult, self.specimens),
        }
        return tables | make_origin_table(self.origins)


_HEADS = ("specimen", "gelatin %", "n", "refused", "radius mm", "SD mm", "95 % interval mm")


def summarise(document: Mapping[str, Any]) -> Summary:
    """Return the paper's table, a row for each needle and gel; imported pictures have none."""
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
        for group in document["specimens"]
    )
    return (TextTable(_HEADS, rows),) if rows else ()
