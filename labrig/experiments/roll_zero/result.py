"""The roll at which a needle bends towards -y, as it is clamped."""

import math
from collections.abc import Mapping
from typing import Literal

import pandas as pd

from labrig.analysis.result import Result, Sentinel, TrialOrigin, make_origin_table, tabulate
from labrig.protocol.model import Model
from labrig.steering.torsion_fit import TorsionFit
from labrig.text import number

# A lag counts as seen from so many of its standard deviations.
_SEEN_SD = 2.0


class TorsionHoleResult(Model):
    """A hole for the torsion: the depth of the turn to 90 degrees, from below (1) or above (-1), and the deflections.

    `bent_mm` is the deflection at the roll zero before the turn, `turned_mm` that behind it; None where a picture does
    not show the needle, for the `reason`.
    """

    hole: int
    depth_mm: float
    direction: int
    bent_mm: float | None
    turned_mm: float | None
    reason: str | None


class TorsionResult(Model):
    """The torsion of the needle: its holes, and the fitted lag of the bevel; None if the fit was refused."""

    holes: tuple[TorsionHoleResult, ...]
    fit: TorsionFit | None


class RollZeroResult(Result):
    """The result of a roll zero run: the deflection at each roll, and the fitted cosine; None if the fit was refused.

    `deflections_mm` are without the perspective. `offset_mm` is the sheath's lateral offset, the constant of
    that fit. `torsion` is None if it was not measured.
    """

    kind: Literal["roll-zero"] = "roll-zero"
    accepted: bool
    reasons: tuple[str, ...]
    needle_id: str
    rolls_rad: tuple[float, ...]
    deflections_mm: tuple[float, ...]
    fit: dict[str, float] | None
    offset_mm: float | None
    origins: tuple[TrialOrigin, ...] = ()
    sentinel: Sentinel | None = None
    torsion: TorsionResult | None = None

    @property
    def tables(self) -> Mapping[str, pd.DataFrame]:
        """The tables of the result."""
        holes = {} if self.torsion is None else {"torsion": tabulate(TorsionHoleResult, self.torsion.holes)}
        return make_origin_table(self.origins) | holes


def describe_torsion(fit: TorsionFit) -> str:
    """Return the lag of the bevel in a sentence."""
    lag = fit.lag
    best_rad = lag.lag_rad + lag.lag_rad_per_mm * lag.best_mm
    grows = abs(lag.lag_rad_per_mm) > _SEEN_SD * lag.per_mm_sd_rad
    if not grows and abs(best_rad) <= _SEEN_SD * lag.best_sd_rad:
        return f"No lag of its bevel was seen (below {math.degrees(_SEEN_SD * fit.sd_rad):.2g} degrees)."
    values = (lag.lag_rad, lag.lag_rad_per_mm, fit.sd_rad)
    behind, per_mm, sd = (number(math.degrees(value)) for value in values)
    return (
        f"Its bevel stays behind the rotation axis by {behind} degrees on either side, and {per_mm} degrees for each "
        f"mm in the gel, SD {sd} degrees."
    )


RunResult = RollZeroResult
