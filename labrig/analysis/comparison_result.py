"""What a comparison of runs says, as `labrig compare --json` prints it, with the errors that measurements share.

No number of measurements makes these smaller, in means and in differences.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal, TypeAlias

import numpy as np
import pandas as pd

from labrig.analysis.calibration import INTRINSICS_FILE, PLANE_FILE
from labrig.analysis.measurements import Measured
from labrig.protocol.model import Model

Interval = tuple[float, float]

_TWO_SIDED_95 = 1.96
_SOURCES = ("lens", "plane", "surface", "roll", "lighting")


class SharedErrors(Model):
    """Standard deviations that no number of measurements makes smaller, in the unit of the quantity.

    A source is None if a measurement of the group does not know it; it is then not in `total`.
    """

    lens: float | None
    plane: float | None
    surface: float | None
    roll: float | None
    lighting: float | None
    total: float


ErrorsByOrigin: TypeAlias = Mapping[str, Mapping[tuple[str, ...], float] | None]
"""For each source of error, by where it comes from: its standard deviation in a mean. None: a source is not known."""


def sum_by_origin(
    part: pd.DataFrame, units: "pd.Series[float]", stem: str, runs: Sequence[Measured]
) -> ErrorsByOrigin:
    """Return what each calibration, mounting of the needle and lamp contributes to the mean of a group.

    The error of one origin is the same in all its measurements, so that its standard deviations add up, not their
    squares; the weight of a measurement is its part of the mean.
    """
    sums: dict[str, dict[tuple[str, ...], float] | None] = {}
    calibrations = {run.name: run.calibration for run in runs}
    by_block = units.index.name == "block"
    sizes = part.groupby("block")["value"].transform("size") if by_block else 1.0
    weights = np.asarray(1.0 / (len(units) * sizes) * np.ones(len(part)), dtype=np.float64)
    for source in _SOURCES:
        column = f"sigma_{stem}_{source}_mm"
        if column not in part or part[column].isna().any() or part.empty:
            sums[source] = None
            continue
        found: dict[tuple[str, ...], float] = {}
        for (_, row), weight in zip(part.iterrows(), weights, strict=True):
            origin = _find_origin(source, row, calibrations)
            found[origin] = found.get(origin, 0.0) + weight * float(row[column])
        sums[source] = found
    return sums


def _find_origin(
    source: str, row: "pd.Series[Any]", calibrations: Mapping[str, Mapping[str, str]]
) -> tuple[str, ...]:
    """Return what an error of this source is shared with."""
    run = str(row["run"])
    if source in {"lens", "plane", "surface"}:
        file = INTRINSICS_FILE if source == "lens" else PLANE_FILE
        return (file, calibrations[run].get(file, run))
    return (run, str(row.get("needle_id"))) if source == "roll" else (run,)


def total_errors(means: Sequence[ErrorsByOrigin]) -> SharedErrors | None:
    """Return the shared errors of a mean, or of the difference of two; None if no source is known."""
    sigmas: dict[str, float | None] = {}
    for source in means[0]:
        known = [mean[source] for mean in means]
        if any(found is None for found in known):
            sigmas[source] = None
            continue
        parts = [found for found in known if found is not None]
        origins = dict.fromkeys(origin for found in parts for origin in found)
        signs = (1.0, -1.0)
        sigmas[source] = math.hypot(
            *(
                sum(sign * found.get(origin, 0.0) for sign, found in zip(signs, parts, strict=False))
                for origin in origins
            )
        )
    if all(sigma is None for sigma in sigmas.values()):
        return None
    return SharedErrors(
        **sigmas, total=math.hypot(*(sigma for sigma in sigmas.values() if sigma is not None))
    )


def widen(interval: Interval | None, errors: SharedErrors | None) -> Interval | None:
    """Return an interval with the shared errors added to its half width, as independent of it."""
    if interval is None or errors is None:
        return None
    middle, half = (interval[0] + interval[1]) / 2.0, (interval[1] - interval[0]) / 2.0
    wide = math.hypot(half, _TWO_SIDED_95 * errors.total)
    return middle - wide, middle + wide


Unit = Literal["specimen", "insertion"]


class Group(Model):
    """The measurements of a group: `n` of the unit of analysis, `insertions` and `specimens` told apart.

    `mean`, `sd` and Student's `ci95` are over the n; `ci95_with_shared` adds the errors that its measurements share.
    `specimens` is None for pictures that name none, `refused` counts measurements without an accepted value.
    """

    name: str
    fields: dict[str, str]
    n: int
    insertions: int
    specimens: int | None
    refused: int
    runs: tuple[str, ...]
    mean: float | None
    sd: float | None
    ci95: Interval | None
    shared_sigma: SharedErrors | None
    ci95_with_shared: Interval | None


class WelchAnova(Model):
    """Welch's analysis of variance."""

    f: float
    df_between: float
    df_within: float
    p: float


class Pair(Model):
    """Two groups: `difference` is the mean of a less that of b, with interval and p by Games and Howell.

    Both are None where neither group has a spread.
    `shared_sigma` is what is left in the difference of the errors that measurements share.
    """

    a: str
    b: str
    difference: float
    ci95: Interval | None
    p: float | None
    shared_sigma: SharedErrors | None
    ci95_with_shared: Interval | None


class UsedRun(Model):
    """A run of the comparison: which of its results, and what is to be known of it."""

    run: str
    experiment: str
    result: int
    overrides: tuple[str, ...]
    exit_status: str
    verdict: str | None
    simulated: bool


class LeftOutRun(Model):
    """A run that is not compared, and why."""

    run: str
    reason: str


class Comparison(Model):
    """The comparison as `labrig compare --json` prints it.

    `unit` is that of the quantity; None without one. `unit_of_analysis` is what `n` counts. `settings_differ` lists the
    settings of measurement that are not the same in all results: for each value, the runs. `warnings` are sentences
    that have to be read with the numbers.
    """

    quantity: str
    unit: str | None
    by: tuple[str, ...]
    unit_of_analysis: Unit
    groups: tuple[Group, ...]
    welch_anova: WelchAnova | None
    pairs: tuple[Pair, ...]
    not_in_interval: tuple[str, ...]
    settings_differ: dict[str, dict[str, tuple[str, ...]]]
    warnings: tuple[str, ...]
    used: tuple[UsedRun, ...]
    left_out: tuple[LeftOutRun, ...]
