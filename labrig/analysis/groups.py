"""Groups of measurements by needle, gel or any other field, what n counts in them, and tests of their means.

The tests do not assume equal variances. scipy has the tests; the first of them loads `scipy.stats`, which takes half a
second. What it does not return is computed here: the degrees of freedom of Welch's test, and the quantile of the
studentized range for a single pair. scipy's table of all pairs takes a fifth of a second for each.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches

import numpy as np
import pandas as pd
import scipy
from numpy.typing import ArrayLike, NDArray
from scipy import optimize, special

from labrig.analysis.comparison_result import Unit
from labrig.analysis.measured_campaign import MeasuredCampaign
from labrig.analysis.measurements import Measured
from labrig.errors import InputError
from labrig.record.condition import BLOCK_NAME, find_paths
from labrig.text import format_count

FloatArray = NDArray[np.float64]
Samples = Sequence[Sequence[float]]

LEVEL = 0.95


@dataclass(frozen=True)
class WelchTest:
    """Welch's test of equal means."""

    f: float
    df_between: float
    df_within: float
    p: float


@dataclass(frozen=True)
class PairTest:
    """The difference of two means, a - b, with its simultaneous interval and p by Games and Howell."""

    difference: float
    ci95: tuple[float, float]
    p: float
    df: float


@dataclass(frozen=True)
class Slope:
    """A slope within blocks, with its 95 % interval, p of no slope, and degrees of freedom."""

    slope: float
    ci95: tuple[float, float]
    p: float
    df: int


def has_spread(sample: Sequence[float]) -> bool:
    """Return whether a sample has at least two values that are not all the same to the last digits."""
    if len(sample) < 2:
        return False
    return float(np.ptp(sample)) > 1e-12 * max(1.0, float(np.max(np.abs(sample))))


def compare_means(samples: Samples) -> WelchTest:
    """Return Welch's ANOVA (1951) of samples that all have a spread."""
    found = scipy.stats.f_oneway(*samples, equal_var=False)
    return WelchTest(
        float(found.statistic), len(samples) - 1.0, _find_welch_freedom(samples), float(found.pvalue)
    )


def _find_welch_freedom(samples: Samples) -> float:
    """Return the second degrees of freedom of Welch's test, equation 30 of his paper, which scipy keeps to itself."""
    n = np.array([len(sample) for sample in samples], dtype=np.float64)
    weight = n / np.array([np.var(sample, ddof=1) for sample in samples])
    groups = len(samples)
    return float((groups**2 - 1) / (3.0 * np.sum((1.0 - weight / weight.sum()) ** 2 / (n - 1))))


def compare_pairs(samples: Samples) -> dict[tuple[int, int], PairTest | None]:
    """Return the test of each pair by Games and Howell; None for a pair without any spread.

    Each sample has at least two values. Keys are the numbers of two samples, the smaller first.
    """
    with np.errstate(all="ignore"):  # a pair without spread is 0 / 0
        p = scipy.stats.tukey_hsd(*samples, equal_var=False).pvalue
    return {
        (a, b): _compare_pair(samples[a], samples[b], float(p[a, b]), len(samples))
        if has_spread(samples[a]) or has_spread(samples[b])
        else None
        for a in range(len(samples))
        for b in range(a + 1, len(samples))
    }


def _compare_pair(a: Sequence[float], b: Sequence[float], p: float, groups: int) -> PairTest:
    squares = np.var(a, ddof=1) / len(a), np.var(b, ddof=1) / len(b)
    df = float(sum(squares) ** 2 / (squares[0] ** 2 / (len(a) - 1) + squares[1] ** 2 / (len(b) - 1)))
    difference = float(np.mean(a) - np.mean(b))
    half = _find_range_quantile(groups, df) * math.sqrt(sum(squares) / 2.0)
    return PairTest(difference, (difference - half, difference + half), p, df)


def _find_range_quantile(groups: int, df: float) -> float:
    """Return the quantile of the studentized range; Student's t for two means and Bonferroni's bound enclose it."""
    alpha = 1.0 - LEVEL
    low = math.sqrt(2.0) * float(special.stdtrit(df, 1.0 - alpha / 2.0))
    if groups == 2:
        return low
    high = math.sqrt(2.0) * float(special.stdtrit(df, 1.0 - alpha / (groups * (groups - 1))))
    return float(
        optimize.brentq(
            lambda q: scipy.stats.studentized_range.sf(q, groups, df) - alpha,
            0.999 * low,
            1.001 * high,
            xtol=1e-5,
        )
    )


def fit_slope(x: ArrayLike, y: ArrayLike, blocks: Sequence[object]) -> Slope | None:
    """Return the slope of y over x that all blocks share, each with a level of its own.

    Centring both on the means of their block leaves this slope to a plain regression, which then counts the levels as
    free though they are fitted: its error is corrected for that.

    Returns
    -------
    Slope or None
        None if x does not vary within blocks, or too few values are left.
    """
    inside = np.column_stack([_centre(x, blocks), _centre(y, blocks)])
    df = len(inside) - len(set(blocks)) - 1
    if df < 1 or not has_spread(list(inside[:, 0])):
        return None
    fit = scipy.stats.linregress(inside[:, 0], inside[:, 1])
    error = float(fit.stderr) * math.sqrt((len(inside) - 2) / df)
    slope = float(fit.slope)
    half = error * float(special.stdtrit(df, (1 + LEVEL) / 2))
    p = 2.0 * float(special.stdtr(df, -abs(slope / error))) if error > 0 else float(slope == 0.0)
    return Slope(slope, (slope - half, slope + half), p, df)


def _centre(values: ArrayLike, blocks: Sequence[object]) -> FloatArray:
    """Return values without the mean of their block."""
    numbers = {block: number for number, block in enumerate(dict.fromkeys(blocks))}
    places = np.array([numbers[block] for block in blocks])
    every = np.asarray(values, dtype=np.float64)
    means: FloatArray = np.bincount(places, every) / np.bincount(places)
    centred: FloatArray = every - means[places]
    return centred


DEFAULT_FIELDS = ("needle_id", "gelatin_percent")
ALIASES: Mapping[str, str] = {"needle": "needle_id", "gel": "gelatin_percent", "gel ratio": "gelatin_percent"}
_FALLBACK = "run"
_ARM = "arm"
"""Of a campaign's task."""


def group_rows(
    rows: pd.DataFrame, runs: Sequence[Measured], by: tuple[str, ...]
) -> tuple[pd.DataFrame, tuple[str, ...], list[str]]:
    """Put measurements into groups by the values of some fields.

    Without fields these are needle and gel, or the arm of a campaign. A measurement that names neither, as an imported
    one, is in the group of its run, and so are all where needle and gel are the same in all runs. Arms of different
    campaigns are different arms, whatever their names.

    Returns
    -------
    rows : DataFrame
        With `group`, empty for a row in none, and for each field its value as text, `by_FIELD`.
    by : tuple of str
        The fields.
    notes : list of str
        Sentences to be told.

    Raises
    ------
    InputError
        When a field is not known, or there is only one group.
    """
    fields = _tell_campaigns_apart(
        by or tuple(name for name in (*DEFAULT_FIELDS, _ARM) if name in rows and rows[name].notna().any()),
        runs,
    )
    grouped = _label_rows(rows, runs, fields, fill=not by)
    notes = []
    if not by and len(runs) > 1 and _count_groups(grouped) < 2:
        if fields:
            notes.append("Needle and gel are the same in all runs: the runs themselves are compared.")
        fields = (_FALLBACK,)
        grouped = _label_rows(rows, runs, fields, fill=False)
    ungrouped = int(grouped["group"].isna().sum())
    if ungrouped:
        told = format_count(ungrouped, "measurement")
        notes.append(f"No {' or '.join(fields)} is known of {told}, which are in no group.")
    if _count_groups(grouped) < 2:
        raise _refuse_single_group(grouped, fields)
    return grouped, fields, notes


def _tell_campaigns_apart(fields: tuple[str, ...], runs: Sequence[Measured]) -> tuple[str, ...]:
    """Return the fields, with the run before the arm where several campaigns have arms."""
    several = sum(isinstance(run, MeasuredCampaign) for run in runs) > 1
    if _ARM not in fields or _FALLBACK in fields or not several:
        return fields
    at = fields.index(_ARM)
    return (*fields[:at], _FALLBACK, *fields[at:])


def _label_rows(
    rows: pd.DataFrame, runs: Sequence[Measured], fields: Sequence[str], *, fill: bool
) -> pd.DataFrame:
    """Return the rows with group and fields; `fill` puts rows of unknown fields into the group of their run."""
    columns = {name: _find_values(rows, runs, name) for name in fields}
    values = zip(*columns.values(), strict=True) if columns else ((None,) for _ in range(len(rows)))
    names = [_name_group(fields, row) if fields else None for row in values]
    labels = [name or (run if fill else None) for name, run in zip(names, rows["run"], strict=True)]
    by = {f"by_{name}": pd.Series(column, dtype=object) for name, column in columns.items()}
    return rows.assign(group=pd.Series(labels, dtype=object), **by)


def _count_groups(rows: pd.DataFrame) -> int:
    return int(rows.loc[rows["value"].notna(), "group"].nunique())


def _refuse_single_group(rows: pd.DataFrame, by: Sequence[str]) -> InputError:
    names = rows.loc[rows["value"].notna(), "group"].dropna().unique()
    what = (
        f"there is only one group: {names[0]}" if len(names) else f"no measurement names {' and '.join(by)}"
    )
    telling = [
        name
        for name in (*DEFAULT_FIELDS, "specimen", "hole", "run")
        if name in rows and rows[name].nunique() > 1 and name not in by
    ]
    others = f"--by {' or --by '.join(telling)} tells them apart, or " if telling else ""
    return InputError(f"nothing to compare: {what}", f"{others}name more runs")


def _find_values(rows: pd.DataFrame, runs: Sequence[Measured], name: str) -> list[str | None]:
    """Return the value of a field for each row, as text; a field of the run has that of its run."""
    if name in rows:
        return [None if pd.isna(value) else _to_text(value) for value in rows[name]]
    by_run = {run.name: _find_run_value(run, name) for run in runs}
    if all(value is None for value in by_run.values()):
        known = dict.fromkeys(str(column) for column in rows.columns if column not in {"value"})
        near = get_close_matches(name, [*known, *ALIASES], 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"--by {name}: no measurement and no run has that field",
            f"{meant}fields: run, experiment, {', '.join((*DEFAULT_FIELDS, 'specimen', 'hole'))}, any other column, "
            "and the keys of manifest and protocol",
        )
    return [by_run[run] for run in rows["run"]]


def _find_run_value(run: Measured, name: str) -> str | None:
    return ", ".join(_list_run_values(run, name)) or None


def _list_run_values(run: Measured, name: str) -> tuple[str, ...]:
    """Return the values of a field of manifest or protocol, each once."""
    values = [
        _to_text(value)
        for path in find_paths(name, run.fields)
        for value in run.fields[path]
        if value is not None and value != ""
    ]
    return tuple(dict.fromkeys(values))


def _to_text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _name_group(by: Sequence[str], values: Sequence[str | None]) -> str | None:
    """Return the name of a group; None if a value is not known."""
    parts = []
    for name, value in zip(by, values, strict=True):
        if value is None:
            return None
        unit = " % gelatin" if name == "gelatin_percent" else ""
        parts.append(
            f"{value}{unit}" if unit or name in {"needle_id", "run", "specimen"} else f"{name} {value}"
        )
    return ", ".join(parts)


def find_blocks(rows: pd.DataFrame, runs: Sequence[Measured]) -> list[str | None]:
    """Return the block of gel of each row: a specimen of a run; None where none is named.

    A specimen with a file is one block in all runs. Others are different blocks in different runs, whatever their
    names: no record says that one was used again. Simulated gel is new in every run.
    """
    if "specimen" not in rows:
        return [None] * len(rows)
    with_file = {run.name: () if run.is_simulated else _list_run_values(run, BLOCK_NAME) for run in runs}
    return [
        None if pd.isna(specimen) else specimen if specimen in with_file[run] else f"{run}/{specimen}"
        for run, specimen in zip(rows["run"], rows["specimen"], strict=True)
    ]


_NO_SPECIMEN = (
    "Some pictures name no specimen. If several show insertions into the same gel, they are no independent values:"
    " intervals are then too narrow, and p too small."
)
_BY_SPECIMEN = "n counts specimens: each block of gel enters by the mean of its insertions."
_ONE_BLOCK = (
    "n counts insertions, which share their block of gel ({}: one block). Intervals and p speak of these blocks alone: "
    "they do not cover how much blocks of the same ratio differ. For that, measure two blocks or more of each."
)


def choose_unit(rows: pd.DataFrame) -> tuple[Unit, list[str]]:
    """Return what n counts, and the sentence that has to be read with it: specimens if every group has two."""
    counted = rows[rows["value"].notna() & rows["group"].notna()]
    if counted["block"].isna().any():
        return "insertion", [_NO_SPECIMEN]
    blocks = counted.groupby("group")["block"].nunique()
    if not (counted.groupby("group").size() > blocks).any():
        return "insertion", []
    if blocks.min() >= 2:
        return "specimen", [_BY_SPECIMEN]
    single = [str(name) for name, count in blocks.items() if count < 2]
    return "insertion", [_ONE_BLOCK.format("; ".join(single[:4]) + ("; ..." if len(single) > 4 else ""))]


def order_groups(rows: pd.DataFrame, by: Sequence[str]) -> list[str]:
    """Return the names of the groups by their values, numbers as numbers."""
    first = rows.dropna(subset=["group"]).drop_duplicates("group")

    def key(row: Sequence[str | None]) -> list[tuple[int, float, str]]:
        return [_sort_key(value) for value in row]

    values = first[[f"by_{name}" for name in by]].to_numpy().tolist()
    return [name for _, name in sorted(zip(map(key, values), first["group"], strict=True))]


def _sort_key(value: str | None) -> tuple[int, float, str]:
    if value is None:
        return (2, 0.0, "")
    try:
        return (0, float(value), "")
    except ValueError:
        return (1, 0.0, value)
