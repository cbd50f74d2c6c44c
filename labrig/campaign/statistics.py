"""What the table of a campaign says of its arms: means, shares, paired differences, and when a rule stops it.

All intervals are of 95 %. That of a mean is Student's, that of a share Wilson's. Differences are between arms with the
same seed and point (common random numbers); with several arms their intervals hold together (Bonferroni).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri, stdtrit
from scipy.stats import binomtest

from labrig.analysis.statistics import compute_spread
from labrig.campaign.campaign_file import CampaignFile
from labrig.errors import InputError
from labrig.protocol.model import Model

Interval = tuple[float, float]
FloatArray = NDArray[np.float64]

_LEAST_FOR_QUANTILE = 10
"""Values; the 90 % quantile of fewer lies between the two largest, whatever the others are."""
_LOOK_AGAIN = 1.25
"""Ratio of the numbers of repetitions at which a rule looks: each further look is a chance to stop too early."""


class ArmResult(Model):
    """What came of an arm.

    `tasks` are done, of which `failed` ended with an error and count for nothing else; `n` have a value of the measure.
    `q90` is None below ten of them. `within_tolerance` are those at most as large as the tolerance; None without one. A
    task without a value has not reached it. `ends` counts how they ended, `success` or the reason.
    """

    name: str
    settings: dict[str, object]
    tasks: int
    failed: int
    n: int
    mean: float | None
    ci95: Interval | None
    sd: float | None
    median: float | None
    q90: float | None
    within_tolerance: int | None
    share: float | None
    share_ci95: Interval | None
    ends: dict[str, int]


class PairResult(Model):
    """The difference of two arms, `b` minus `a`, over tasks with the same seed and point.

    `n` pairs have a value in both; `mean` is that of their differences. `share` is that of the shares within the
    tolerance, over `pairs` without an error in either arm (Agresti and Min 2005).
    """

    a: str
    b: str
    n: int
    mean: float | None
    ci95: Interval | None
    pairs: int
    share: float | None
    share_ci95: Interval | None


@dataclass(frozen=True)
class Judgement:
    """By what tasks are judged: a column of the table, and its largest value that counts as reached, None without."""

    measure: str
    tolerance: float | None


def require_measure(by: Judgement, values: Mapping[str, object]) -> None:
    """Refuse a measure that tasks do not have, or that is a word.

    Parameters
    ----------
    values : Mapping of str to object
        The quantities of a task by name; None where it has no value.

    Raises
    ------
    InputError
        Lists the quantities that there are.
    """
    known = [name for name, value in values.items() if not isinstance(value, str)]
    if by.measure not in known:
        near = get_close_matches(by.measure, known, 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"measure: the tasks have no number {by.measure!r}", f"{meant}name one of: {', '.join(known)}"
        )


def judge_arm(table: pd.DataFrame, name: str, settings: Mapping[str, object], by: Judgement) -> ArmResult:
    """Return what came of an arm.

    Parameters
    ----------
    table : DataFrame
        The rows of the arm.
    """
    sound = table[table["error"].isna()]
    values = read_values(sound, by.measure)
    known = values[~np.isnan(values)]
    spread = compute_spread(known.tolist())
    reached = None if by.tolerance is None else int((known <= by.tolerance).sum())
    return ArmResult(
        name=name,
        settings=dict(settings),
        tasks=len(table),
        failed=len(table) - len(sound),
        n=spread.n,
        mean=spread.mean,
        ci95=spread.ci95,
        sd=spread.sd,
        median=float(np.median(known)) if len(known) else None,
        q90=float(np.quantile(known, 0.9)) if len(known) >= _LEAST_FOR_QUANTILE else None,
        within_tolerance=reached,
        share=None if reached is None or not len(sound) else reached / len(sound),
        share_ci95=None if reached is None else bound_share(reached, len(sound)),
        ends=count_ends(sound),
    )


def count_ends(table: pd.DataFrame) -> dict[str, int]:
    """Return how tasks ended, the most frequent first: `success`, or the reason."""
    ends = table["reason"].where(table["exit_status"] != "success", "success").fillna(table["exit_status"])
    return dict(Counter(ends.astype(str)).most_common())


def bound_share(count: int, of: int) -> Interval | None:
    """Return Wilson's interval of a share; None of nothing."""
    if of == 0:
        return None
    limits = binomtest(count, of).proportion_ci(0.95, "wilson")
    return float(limits.low), float(limits.high)


def read_values(table: pd.DataFrame, measure: str) -> FloatArray:
    """Return a column as numbers (N,), NaN where a task has no value, or no task has the column."""
    if measure not in table.columns:
        return np.full(len(table), np.nan)
    return pd.to_numeric(table[measure], errors="coerce").to_numpy(np.float64, na_value=np.nan)


def compare_arms(table: pd.DataFrame, names: Sequence[str], by: Judgement) -> tuple[PairResult, ...]:
    """Return the difference of each further arm from the first one."""
    first, *others = names
    return tuple(_compare(table, first, other, by, len(others)) for other in others)


def _compare(table: pd.DataFrame, a: str, b: str, by: Judgement, pairs: int) -> PairResult:
    same = ["repetition", "point"]
    sound = table[table["error"].isna()].assign(value=lambda rows: read_values(rows, by.measure))
    both = sound[sound["arm"] == a].merge(sound[sound["arm"] == b], on=same, suffixes=("_a", "_b"))
    values = both[["value_a", "value_b"]].to_numpy(np.float64)
    known = values[~np.isnan(values).any(axis=1)]
    level = 1.0 - 0.025 / pairs
    share, share_ci95 = _compare_shares(values, by.tolerance, level)
    differences = known[:, 1] - known[:, 0]
    return PairResult(
        a=a,
        b=b,
        n=len(known),
        mean=float(differences.mean()) if len(known) else None,
        ci95=_bound_mean(differences, level),
        pairs=len(values),
        share=share,
        share_ci95=share_ci95,
    )


def _bound_mean(values: FloatArray, level: float) -> Interval | None:
    if len(values) < 2:
        return None
    half = float(stdtrit(len(values) - 1, level)) * float(values.std(ddof=1)) / math.sqrt(len(values))
    mean = float(values.mean())
    return mean - half, mean + half


def _compare_shares(
    values: FloatArray, tolerance: float | None, level: float
) -> tuple[float | None, Interval | None]:
    """Return the difference of paired shares, and its interval by Agresti and Min: half a pair added to each cell."""
    if tolerance is None or not len(values):
        return None, None
    reached = values <= tolerance
    gained = int((~reached[:, 0] & reached[:, 1]).sum())
    lost = int((reached[:, 0] & ~reached[:, 1]).sum())
    b, c, n = gained + 0.5, lost + 0.5, len(values) + 2.0
    centre, half = (b - c) / n, float(ndtri(level)) * math.sqrt(b + c - (b - c) ** 2 / n) / n
    share = (gained - lost) / len(values)
    return share, (max(-1.0, centre - half), min(1.0, centre + half)) if len(values) > 1 else None


class WidthRule:
    """Stops a campaign when the interval of every arm's mean is narrow enough (Chow and Robbins 1965).

    It looks after whole repetitions only: first after `first_look` of them, then whenever there are a quarter more. So
    the same rows stop it at the same place, whoever made them and however often it was interrupted.

    Parameters
    ----------
    campaign : CampaignFile
        Without `stop_when` the rule never ends it.
    measure : str
        The column.
    """

    def __init__(self, campaign: CampaignFile, measure: str) -> None:
        rule = campaign.stop_when
        self._width = None if rule is None else rule.ci95_width_mm
        self._round_tasks = campaign.arm_count * campaign.points
        self._measure = measure
        self._look = campaign.first_look()
        self._taken = 0
        self._arms: dict[str, list[float]] = {}

    def take(self, row: Mapping[str, object]) -> bool:
        """Take a row, in the order of the tasks, and return whether the campaign ends with it."""
        if self._width is None:
            return False
        self._taken += 1
        values = self._arms.setdefault(str(row["arm"]), [])
        value = row.get(self._measure)
        if row.get("error") is None and isinstance(value, int | float):
            values.append(float(value))
        repetitions, rest = divmod(self._taken, self._round_tasks)
        if rest or repetitions < self._look:
            return False
        self._look = max(self._look + 1, math.ceil(_LOOK_AGAIN * self._look))
        return all(_is_narrow(values, self._width) for values in self._arms.values())


def _is_narrow(values: Sequence[float], width: float) -> bool:
    ci95 = compute_spread(values).ci95
    return ci95 is not None and ci95[1] - ci95[0] <= width
