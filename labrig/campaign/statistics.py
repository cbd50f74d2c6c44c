"""What the table of a campaign says of its arms: means, shares, paired differences, and when a rule stops it.

All intervals are of 95 %. That of a mean is Student's, that of a share Wilson's. Differences are between arms with the
same seed and point (common random numbers); with several arms their intervals hold together (Bonferroni).
"""

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from scipy.special import ndtri
from scipy.stats import binomtest

from labrig.analysis.statistics import Spread, compute_spread
from labrig.campaign.campaign_file import CampaignFile
from labrig.campaign.store import make_table
from labrig.errors import InputError
from labrig.protocol.model import Model
from labrig.protocol.sections import Criterion

Interval = tuple[float, float]
FloatArray = NDArray[np.float64]

BROKEN_OFF, WITHOUT_VALUE = "broken_off", "without_value"
"""Of a task: it was stopped on the way, which its row tells; it has no value for another reason."""
_TOLD = ("true_target_error_mm", "target_error_low_mm", "target_error_high_mm")
_MEASURED = r"\b\d+\.\d\d mm"
"""What differs between tasks with the same reason; a limit has fewer decimals."""
_LEAST_FOR_QUANTILE = 10
"""Values; the 90 % quantile of fewer lies between the two largest, whatever the others are."""


class ArmResult(Model):
    """What came of an arm.

    `tasks` are done, of which `failed` ended with an error and count for nothing else. `n` came to their end with a
    value of the measure, `broken_off` were stopped on the way, which is no value, and others have none. `q90` is None
    below ten values. `within_tolerance` are those at most as large as the tolerance; None without one. A task without a
    value has not reached it. `false_successes` ended as a success beyond it. `ends` counts how they ended: `success`,
    `broken_off`, or the reason.
    """

    name: str
    settings: dict[str, object]
    tasks: int
    failed: int
    broken_off: int
    n: int
    mean: float | None
    ci95: Interval | None
    sd: float | None
    median: float | None
    q90: float | None
    within_tolerance: int | None
    share: float | None
    share_ci95: Interval | None
    false_successes: int | None
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
    sd: float | None
    ci95: Interval | None
    pairs: int
    share: float | None
    share_ci95: Interval | None


def require_measure(by: Criterion, quantities: Sequence[str]) -> None:
    """Refuse a measure that is none of the quantities that tasks have as numbers. Raises `InputError`, lists them."""
    if by.quantity not in quantities:
        near = get_close_matches(by.quantity, quantities, 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"measure: the tasks have no number {by.quantity!r}",
            f"{meant}name one of: {', '.join(quantities)}",
        )


def judge_arm(table: pd.DataFrame, name: str, settings: Mapping[str, object], by: Criterion) -> ArmResult:
    """Return what came of an arm.

    Parameters
    ----------
    table : DataFrame
        The rows of the arm.
    """
    sound = table[table["error"].isna()]
    values = read_values(sound, by.quantity)
    known = values[~np.isnan(values)]
    spread = spread_values(known.tolist(), by.quantity)
    reached = None if by.tolerance is None else int((known <= by.tolerance).sum())
    ended = name_ends(sound)
    return ArmResult(
        name=name,
        settings=dict(settings),
        tasks=len(table),
        failed=len(table) - len(sound),
        broken_off=int((ended == BROKEN_OFF).sum()),
        **vars(spread),
        median=float(np.median(known)) if len(known) else None,
        q90=float(np.quantile(known, 0.9)) if len(known) >= _LEAST_FOR_QUANTILE else None,
        within_tolerance=reached,
        share=None if reached is None or not len(sound) else reached / len(sound),
        share_ci95=None if reached is None else bound_share(reached, len(sound)),
        false_successes=None if reached is None else int(find_false_successes(sound, by).sum()),
        ends=count_alike(ended),
    )


def spread_values(values: Sequence[float], quantity: str) -> Spread:
    """Return the spread of values; the interval of a mean distance ends at 0, though Student's goes on."""
    spread = compute_spread(values)
    if spread.ci95 is None or not quantity.endswith("error_mm") or min(values) < 0.0:
        return spread
    return replace(spread, ci95=(max(0.0, spread.ci95[0]), spread.ci95[1]))


def name_ends(table: pd.DataFrame) -> "pd.Series[str]":
    """Return how each task ended: `success`, `broken_off`, or the reason."""
    ends = table["reason"].where(table["exit_status"] != "success", "success").fillna(table["exit_status"])
    return ends.astype(str).mask(_find_broken_off(table), BROKEN_OFF)


def find_false_successes(sound: pd.DataFrame, by: Criterion) -> "pd.Series[bool]":
    """Return which tasks ended as a success beyond the tolerance; none without a tolerance."""
    beyond = read_values(sound, by.quantity) > (math.inf if by.tolerance is None else by.tolerance)
    return (name_ends(sound) == "success") & beyond


def count_alike(texts: "pd.Series[str]") -> dict[str, int]:
    """Return how often each text is there, the most frequent first, whatever lengths were measured in it."""
    return dict(Counter(texts.str.replace(_MEASURED, "… mm", regex=True)).most_common())


def _find_broken_off(table: pd.DataFrame) -> "pd.Series[bool]":
    return pd.Series(table.get(BROKEN_OFF, 0), table.index, dtype="boolean").fillna(value=False).astype(bool)


def find_failing(table: pd.DataFrame, measure: str) -> dict[str, NDArray[np.bool_]]:
    """Return which tasks were broken off on the way, and which others have no value of the measure."""
    off = _find_broken_off(table).to_numpy()
    return {BROKEN_OFF: off, WITHOUT_VALUE: ~off & np.isnan(read_values(table, measure))}


def find_missed(table: pd.DataFrame) -> FloatArray:
    """Return 1 where the interval that a task told missed the true distance, 0 where not, NaN where it told none."""
    true, low, high = (read_values(table, name) for name in _TOLD)
    return np.where(np.isnan(true + low), np.nan, (true < low) | (true > high))


def bound_share(count: int, of: int) -> Interval | None:
    """Return Wilson's interval of a share; None of nothing."""
    if of == 0:
        return None
    limits = binomtest(count, of).proportion_ci(0.95, "wilson")
    return float(limits.low), float(limits.high)


def read_values(table: pd.DataFrame, measure: str) -> FloatArray:
    """Return a column as numbers (N,), NaN where a task has no value or was broken off, or no task has the column."""
    column = table.get(measure, pd.Series(np.nan, table.index))
    values = pd.to_numeric(column, errors="coerce").mask(_find_broken_off(table))
    return values.to_numpy(np.float64, na_value=np.nan)


def compare_arms(table: pd.DataFrame, names: Sequence[str], by: Criterion) -> tuple[PairResult, ...]:
    """Return the difference of each further arm from the first one."""
    first, *others = names
    return tuple(_compare(table, first, other, by, len(others)) for other in others)


def correlate(table: pd.DataFrame, keys: Sequence[str], by: Criterion) -> dict[str, dict[str, float]]:
    """Return Spearman's rank correlations with each sampled key: of the measure, of failures, of intervals that missed.

    Of failures: of each way to fail outright. That of the measure is over the tasks that have a value. Fewer than ten
    tasks have no correlation.
    """
    sound = table[table["error"].isna()]
    value = pd.Series(read_values(sound, by.quantity), sound.index)
    failing = {**find_failing(sound, by.quantity), "interval_missed": find_missed(sound)}
    ends = pd.DataFrame({by.quantity: value, **failing}).astype(float)
    found = sound[[*keys]].join(ends).corr("spearman").loc[[*keys]]
    if len(sound) < _LEAST_FOR_QUANTILE:
        return {}
    return {str(end): {key: found[end][key] for key in found[end].dropna().index} for end in ends}


def _compare(table: pd.DataFrame, a: str, b: str, by: Criterion, pairs: int) -> PairResult:
    sound = table[table["error"].isna()].assign(value=lambda rows: read_values(rows, by.quantity))
    both = sound[sound["arm"] == a].merge(
        sound[sound["arm"] == b], on=["repetition", "point"], suffixes=("_a", "_b")
    )
    values = both[["value_a", "value_b"]].to_numpy(np.float64)
    differences = values[:, 1] - values[:, 0]
    spread = compute_spread(differences[~np.isnan(differences)].tolist(), pairs)
    share, share_ci95 = _compare_shares(values, by.tolerance, pairs)
    return PairResult(a=a, b=b, **vars(spread), pairs=len(values), share=share, share_ci95=share_ci95)


def _compare_shares(
    values: FloatArray, tolerance: float | None, pairs: int
) -> tuple[float | None, Interval | None]:
    """Return the difference of paired shares, and its interval by Agresti and Min: half a pair added to each cell."""
    if tolerance is None or not len(values):
        return None, None
    reached = values <= tolerance
    gained = int((~reached[:, 0] & reached[:, 1]).sum())
    lost = int((reached[:, 0] & ~reached[:, 1]).sum())
    b, c, n = gained + 0.5, lost + 0.5, len(values) + 2.0
    centre, half = (b - c) / n, float(ndtri(1.0 - 0.025 / pairs)) * math.sqrt(b + c - (b - c) ** 2 / n) / n
    share = (gained - lost) / len(values)
    return share, (max(-1.0, centre - half), min(1.0, centre + half)) if len(values) > 1 else None


def ends_by_rule(file: CampaignFile, by: Criterion, rows: Sequence[Mapping[str, object]]) -> bool:
    """Return whether a campaign ends with these rows: the interval of every arm's mean is narrow enough.

    The rule (Chow and Robbins 1965) looks after whole repetitions alone, so that the same rows end it at the same
    place, whoever made them and however often it was interrupted.
    """
    repetitions, rest = divmod(len(rows), file.round_tasks)
    if file.stop_when is None or rest or repetitions not in file.looks:
        return False
    arms = make_table(rows).groupby("arm")
    intervals = [judge_arm(table, str(name), {}, by).ci95 for name, table in arms]
    return all(ci95 and ci95[1] - ci95[0] <= file.stop_when.ci95_width_mm for ci95 in intervals)
