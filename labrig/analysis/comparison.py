"""Compares the measurements of runs, group by group; the room's docstring says what is counted, and why.

Errors that measurements share are in no scatter: no number of measurements makes these smaller, in means and in
differences.
"""

import math
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any

import numpy as np
import pandas as pd

from labrig.analysis.groups import Unit, choose_unit, group_rows, name_policy
from labrig.analysis.measurements import LeftOut, Measured, UsedRun, join_measurements
from labrig.analysis.pictures import INTRINSICS_FILE, PLANE_FILE
from labrig.analysis.result import note_overrides
from labrig.analysis.statistics import (
    TWO_SIDED_95,
    Interval,
    WelchAnova,
    compare_means,
    compare_pairs,
    compute_spread,
)
from labrig.errors import InputError
from labrig.protocol.model import Model
from labrig.record.difference import find_differences
from labrig.steering.parameters import PAPER_SECTIONS, SECTIONS
from labrig.text import format_count, split_key, split_quantity, tell_value

DEFAULT_QUANTITIES = ("radius_mm", "target_error_mm")
MOST_GROUPS_IN_PAIRS = 12
"""A pair takes a third of a second where there are many groups, and a page of 66 pairs is as much as anybody reads."""
_MOST_HINTED = 15
_MOST_KEYS = 2
_OWN_SEED = " These gels have the same seed, name and needle; another seed in each protocol draws others."
NAMING = frozenset({"title", "notes", "operator", "seed", "specimen", "specimens", "needle_id"})
_OF_POLICY = {f"{section}.{key}" for section, values in PAPER_SECTIONS.items() for key in values}
_INTERVALS = ("ci95_low", "ci95_high", "sigma_")


SharedErrors = dict[str, float | None]
"""Standard deviations that no number of measurements makes smaller, in the unit of the quantity, and their `total`.

A source is None if a measurement of the group does not know it; it is then not in the total.
"""


class Group(Model):
    """The measurements of a group: `n` of the unit of analysis, `insertions` and `specimens` told apart.

    `mean`, `sd` and Student's `ci95` are over the n; `ci95_with_shared` adds the errors that its measurements share.
    `specimens` is None for pictures that name none, `refused` counts measurements without an accepted value.
    """

    name: str
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


class Comparison(Model):
    """The comparison as `labrig compare --json` prints it.

    `unit` is that of the quantity; None without one. `unit_of_analysis` is what `n` counts. `warnings` are sentences
    that have to be read with the numbers. `left_out` has for each `run` that is not compared the `reason`.
    """

    quantity: str
    unit: str | None
    by: tuple[str, ...]
    unit_of_analysis: Unit
    groups: tuple[Group, ...]
    welch_anova: WelchAnova | None
    pairs: tuple[Pair, ...]
    not_in_interval: tuple[str, ...]
    warnings: tuple[str, ...]
    used: tuple[UsedRun, ...]
    left_out: tuple[dict[str, str], ...]


@dataclass(frozen=True, eq=False)
class ComparedRuns:
    """A comparison, and the measurements behind it.

    `table` has a row for each measurement, with the columns `group` (empty if it is in none), `block` and `value`;
    `asked` are the fields that were asked for.
    """

    comparison: Comparison
    table: pd.DataFrame
    asked: tuple[str, ...]


def compare_runs(
    runs: Sequence[Measured],
    left_out: Sequence[LeftOut] = (),
    *,
    quantity: str | None = None,
    by: Sequence[str] = (),
) -> ComparedRuns:
    """Compare a quantity between groups of measurements.

    Parameters
    ----------
    runs : sequence of Measured
        Runs with their results.
    left_out : sequence of LeftOut
        Runs that could not be opened, to be listed.
    quantity : str or None
        A column of a table of the results, or `TABLE.COLUMN`; None: the radius, or else the target error,
        that all runs have which measure anything.
    by : sequence of str
        Fields whose values make the groups: columns of the table, or keys of manifest and protocol. Empty: needle and
        gel; the runs where these are not known, or are the same in all of them.

    Raises
    ------
    InputError
        When there is no such quantity or field, or nothing to compare.
    """
    wanted = _choose_quantity(runs) if quantity is None else quantity
    used = [run for run in runs if run.find_column(wanted) is not None]
    if not used:
        raise _refuse_quantity(repr(wanted), runs)
    rows, fields, notes = group_rows(_read_rows(used, wanted), used, by)
    counted = rows[rows["value"].notna() & rows["group"].notna()]
    unit, unit_notes = choose_unit(counted)
    simulated = counted["run"].isin([run.name for run in used if run.about.simulated])
    insertions = _name_insertions(counted, simulated)
    made = counted.groupby(["group", "block", insertions], sort=False, dropna=False)["value"].mean()
    units = made.groupby(["group", "block" if unit == "specimen" else "insertion"], sort=False).mean()
    shared = _find_shared(counted.assign(insertion=insertions), unit, wanted, used)
    least = 0.0 if wanted.endswith("error_mm") and units.min() >= 0.0 else -math.inf
    groups = tuple(
        _summarise(str(name), part, units.get(name, units[:0]), _total(shared.get(name)), least)
        for name, part in rows.groupby("group", sort=False)
    )
    samples = {group.name: list(units[group.name]) for group in groups if group.n > 1}
    omitted = {str(run.run): run.error.message for run in left_out}
    omitted |= {run.name: f"its result has no {wanted}" for run in runs if run not in used}
    comparison = Comparison(
        quantity=wanted,
        unit=split_quantity(wanted)[1],
        by=fields,
        unit_of_analysis=unit,
        groups=groups,
        welch_anova=compare_means(list(samples.values())),
        pairs=tuple(_test_pairs(samples, shared)),
        not_in_interval=tuple(dict.fromkeys(source for run in used for source in run.not_in_interval)),
        warnings=(
            *unit_notes,
            *notes,
            *_note_shared(counted, simulated),
            *_note_settings(used, fields),
            *_note_repeats(counted, insertions),
            *(sentence for run in used for sentence in _note_run(run)),
            *_note_groups(groups, {run.about.simulated for run in used}),
        ),
        used=tuple(run.about for run in used),
        left_out=tuple({"run": name, "reason": why} for name, why in omitted.items()),
    )
    return ComparedRuns(comparison, rows, tuple(by))


def _choose_quantity(runs: Sequence[Measured]) -> str:
    measuring = [run for run in runs if run.quantities]
    for name in DEFAULT_QUANTITIES:
        if measuring and all(run.find_column(name) is not None for run in measuring):
            return name
    raise _refuse_quantity("in common that is compared by default", runs)


def _refuse_quantity(what: str, runs: Sequence[Measured]) -> InputError:
    known = list(dict.fromkeys(name for run in runs for name in run.quantities))
    named = [name for name in known if not any(part in name for part in _INTERVALS)]
    near = get_close_matches(what.strip("'"), known, 1)
    meant = f"did you mean {near[0]}? " if near else ""
    hint = f"{meant}name one with --quantity: {', '.join(named[:_MOST_HINTED])}"
    return InputError(
        f"these runs have no quantity {what}", hint if named else "none has measurements of trials"
    )


def _read_rows(runs: Sequence[Measured], quantity: str) -> pd.DataFrame:
    """Return the measurements with the column `value`, empty where it was refused or left out."""
    tables = []
    for run in runs:
        table, column = run.find_column(quantity) or ("", "")
        rows = run.list_measurements(table)
        value = pd.to_numeric(rows[column], errors="coerce")
        if rows[column].notna().any() and value.isna().all():
            raise InputError(f"{column} is no number in {run.name}", "name another with --quantity")
        accepted = rows["left_out"].isna() & np.isfinite(value)
        if "accepted" in rows:
            accepted &= rows["accepted"].astype("boolean").fillna(value=False)
        if "refused" in rows and quantity.endswith("error_mm"):
            # How far from its target a needle was broken off is no error of its way.
            accepted &= rows["outcome"].ne("stopped") & rows["refused"].isna()
        tables.append(rows.assign(value=value.astype("float64").where(accepted)))
    joined = join_measurements(tables)
    if joined.empty or joined["value"].isna().all():
        raise InputError(f"no measurement of {quantity} was accepted", "labrig report shows why")
    return joined


def _find_shared(rows: pd.DataFrame, unit: Unit, quantity: str, runs: Sequence[Measured]) -> pd.DataFrame:
    """Return what each calibration, mounting of the needle and lamp contributes to the mean of each group.

    The error of one origin is the same in all its measurements, so that its standard deviations add up, not their
    squares; the weight of a measurement is its part of the mean, in which each `insertion` counts once.

    Returns
    -------
    DataFrame
        A row for each `source` and origin, a column for each group; not a number where the group does not know it.
    """
    stem = quantity.rpartition(".")[2].rpartition("_")[0]
    lens, plane = (
        rows["run"].map({run.name: run.run.calibration_hashes.get(file, run.name) for run in runs})
        for file in (INTRINSICS_FILE, PLANE_FILE)
    )
    mounting = rows["run"] + "/" + rows.get("needle_id", rows["run"]).astype(str)
    origins = {"lens": lens, "plane": plane, "surface": plane, "roll": mounting, "lighting": rows["run"]}
    within = ["group", "block"] if unit == "specimen" else ["group"]
    parts = rows.groupby(within)["insertion"].transform("nunique")
    parts *= rows.groupby([*within, "insertion"])["value"].transform("size")
    if unit == "specimen":
        parts *= rows.groupby("group")["block"].transform("nunique")
    sums = {
        source: (rows.get(f"sigma_{stem}_{source}_mm", math.nan) / parts)
        .groupby([origin, rows["group"]])
        .agg(lambda sigmas: sigmas.sum(skipna=False))
        .unstack(fill_value=0)
        for source, origin in origins.items()
    }
    return pd.concat(sums, names=["source"])


def _total(errors: "pd.Series[float] | None") -> SharedErrors | None:
    """Return the shared errors of a mean, or of a difference, from those of each origin; None if no source is known.

    Origins are independent; the needle's mounting and the light of two runs may be the same, so that the larger counts.
    """
    if errors is None:
        return None
    parts = errors.groupby("source", sort=False)
    roots, sums = parts.agg(np.linalg.norm), parts.agg(lambda part: part.sum(skipna=False))
    by_source = roots.clip(lower=sums.abs().where(sums.index.isin(["roll", "lighting"]), 0.0))
    known = by_source.dropna()
    if known.empty:
        return None
    sigmas = {str(source): None if math.isnan(sigma) else float(sigma) for source, sigma in by_source.items()}
    return {**sigmas, "total": float(np.linalg.norm(known))}


def _widen(interval: Interval | None, errors: SharedErrors | None) -> Interval | None:
    """Return an interval with the shared errors added to its half width, as independent of it."""
    if interval is None or errors is None:
        return None
    middle, half = (interval[0] + interval[1]) / 2.0, (interval[1] - interval[0]) / 2.0
    wide = math.hypot(half, TWO_SIDED_95 * (errors["total"] or 0.0))
    return middle - wide, middle + wide


def _summarise(
    name: str, rows: pd.DataFrame, units: "pd.Series[float]", errors: SharedErrors | None, least: float
) -> Group:
    spread = compute_spread(list(units))
    ends = [each and (max(each[0], least), each[1]) for each in (spread.ci95, _widen(spread.ci95, errors))]
    counted = rows[rows["value"].notna()]
    return Group(
        name=name,
        **(vars(spread) | {"ci95": ends[0]}),
        insertions=len(counted),
        specimens=None if counted["block"].isna().any() else int(counted["block"].nunique()),
        refused=len(rows) - len(counted),
        runs=tuple(rows["run"].unique()),
        shared_sigma=errors,
        ci95_with_shared=ends[1],
    )


def _test_pairs(samples: Mapping[str, Sequence[float]], shared: pd.DataFrame) -> Iterator[Pair]:
    """Yield the test of each pair of groups; none of more groups than anybody reads."""
    if len(samples) > MOST_GROUPS_IN_PAIRS:
        return
    names = list(samples)
    for (i, j), test in compare_pairs(list(samples.values())).items():
        errors = _total(shared[names[i]] - shared[names[j]])
        wide = _widen(test.ci95, errors)
        yield Pair(a=names[i], b=names[j], **test._asdict(), shared_sigma=errors, ci95_with_shared=wide)


def _note_shared(counted: pd.DataFrame, simulated: "pd.Series[bool]") -> Iterable[str]:
    """Say so where groups share blocks of gel, in a simulation with the same needle, so that they are paired."""
    named = counted.reindex(columns=["block", "needle_id"]).astype("string").fillna("")
    drawn = (named["block"] + "/" + named["needle_id"]).where(simulated & counted["block"].notna())
    blocks = counted["block"].mask(simulated)
    for noun, kept, advice in (("specimen", blocks, ""), ("simulated gel", drawn, _OWN_SEED)):
        shared = int((counted.groupby(kept)["group"].nunique() > 1).sum())
        if shared and counted["group"].duplicated().any():
            yield (
                f"{format_count(shared, noun)} {'is' if shared == 1 else 'are'} in more than one group. What is common "
                f"cancels in their difference, but these tests do not pair.{advice}"
            )


def _note_settings(runs: Sequence[Measured], by: Sequence[str]) -> Iterable[str]:
    """Yield in what runs were set otherwise, by protocol, rig file or afterwards.

    What names runs or groups is left out; where policies are compared, also what each of them says.
    """
    told, policies = {}, list(map(name_policy, runs))
    made = ({**run.run.protocol, **run.settings, "rig": run.run.rig} for run in runs)
    for key, values in find_differences(*made):
        said = {*zip(policies, values, strict=True)}
        by_policy = key in _OF_POLICY and "policy" in by and len(said) == len({*policies})
        if not by_policy and NAMING.union(by).isdisjoint({key, *key.split(".")}):
            alike = defaultdict[str, list[str]](list)
            for run, value in zip(runs, values, strict=True):
                alike["not stated" if value is None else tell_value(value, key)].append(run.name)
            words = (f"{value} in {_list_some(names)}" for value, names in alike.items())
            name = key if key.split(".")[0] in {*SECTIONS, "rig"} else split_key(key)[0]
            told[key.removeprefix("analysis.")] = f"{name} ({'; '.join(words)})"
    if told:
        named = ", ".join(dict.fromkeys(key.partition(".")[0].replace("_", " ") for key in told))
        many = f"{named}: the page lists them under What was done"
        yield f"The settings of the runs differ in {', '.join(told.values()) if len(told) <= _MOST_KEYS else many}."


def _name_insertions(counted: pd.DataFrame, simulated: "pd.Series[bool]") -> "pd.Series[Any]":
    """Return which insertion each measurement is of: that of its run, and in a simulation that of its draw.

    A world draws a block by seed and name, and an insertion into it by needle and hole: runs may have the same.
    """
    named = counted.reindex(columns=["block", "needle_id", "hole"]).astype("string")
    drawn = (named["block"] + "/" + named["needle_id"] + "/" + named["hole"]).where(simulated)
    pictures = counted.index.to_series().astype("string")
    trials = counted["run"] + "/" + counted["trial"].astype("string").combine_first(pictures)
    return drawn.combine_first(trials).rename("insertion")


def _note_repeats(counted: pd.DataFrame, insertions: "pd.Series[Any]") -> Iterable[str]:
    """Say which runs repeat what another one has simulated: equal draws are no second measurement."""
    drawn = counted.groupby(["group", insertions])["run"]
    names = list(counted["run"][drawn.transform("nunique") > 1].unique())
    if names:
        yield f"{_list_some(names)} have insertions in common, of one seed: in a group each counts once, by its mean."


def _note_run(run: Measured) -> Iterable[str]:
    about, reason = run.about, run.run.manifest.get("reason")
    yield from note_overrides(about.run, about.result, about.overrides)
    if about.verdict in {"bad", "doubtful"}:
        yield f"{about.run} was judged {about.verdict}."
    # One that missed was measured to its end, and the page names its outcome.
    if about.exit_status != "success" and reason not in {"target_missed", "reached_in_plane_only"}:
        yield f"{about.run} did not succeed ({about.exit_status}): only what it measured before its end is compared."


def _note_groups(groups: Sequence[Group], simulated: set[bool]) -> Iterable[str]:
    if len(simulated) > 1:
        yield "Simulated runs and others are compared with each other."
    single = [group.name for group in groups if group.n < 2]
    if single and len(single) < len(groups):
        yield f"Listed, but not tested, for less than two values: {_list_some(single)}."
    flat = [group.name for group in groups if group.sd == 0.0]
    if flat:
        yield f"All values are the same in {_list_some(flat)}: without a spread there is no Welch's ANOVA."
    tested = sum(group.n > 1 for group in groups)
    if tested > MOST_GROUPS_IN_PAIRS:
        pairs = tested * (tested - 1) // 2
        yield f"{tested} groups make {pairs} pairs, left out: at most {MOST_GROUPS_IN_PAIRS} groups are paired."


def _list_some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
