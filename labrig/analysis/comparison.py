"""Compares the measurements of runs, group by group; the room's docstring says what is counted, and why."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from itertools import combinations

import numpy as np
import pandas as pd

from labrig.analysis.comparison_result import (
    Comparison,
    ErrorsByOrigin,
    Group,
    LeftOutRun,
    Pair,
    Unit,
    UsedRun,
    WelchAnova,
    sum_by_origin,
    total_errors,
    widen,
)
from labrig.analysis.groups import (
    ALIASES,
    Samples,
    choose_unit,
    compare_means,
    compare_pairs,
    find_blocks,
    group_rows,
    has_spread,
    order_groups,
)
from labrig.analysis.measured_campaign import MeasuredCampaign
from labrig.analysis.measurements import LeftOut, Measured, join_measurements
from labrig.analysis.statistics import compute_spread
from labrig.errors import InputError
from labrig.text import format_count

DEFAULT_QUANTITIES = ("radius_mm", "target_error_mm")
MOST_GROUPS_IN_PAIRS = 12
"""A pair takes a third of a second where there are many groups, and a page of 66 pairs is as much as anybody reads."""
_MOST_HINTED = 15
_INTERVALS = ("ci95_low", "ci95_high", "sigma_")


@dataclass(frozen=True, eq=False)
class ComparedRuns:
    """A comparison, and the measurements behind it.

    `table` has a row for each measurement, with the columns `group` (empty if it is in none), `block` and `value`.
    """

    comparison: Comparison
    table: pd.DataFrame


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
        A column of a table of the results, or `TABLE.COLUMN`; None: that of the campaigns' pages, if all are
        campaigns and these agree, else the radius, or else the target error, that all runs have which measure anything.
    by : sequence of str
        Fields whose values make the groups: columns of the table, or keys of manifest and protocol. Empty: needle and
        gel; the runs where these are not known, or are the same in all of them.

    Raises
    ------
    InputError
        When there is no such quantity or field, or nothing to compare.
    """
    wanted = _choose_quantity(runs) if quantity is None else quantity
    used, without = _split_by_quantity(runs, wanted)
    omitted = (
        *(LeftOutRun(run=str(run.run), reason=run.error.message) for run in left_out),
        *(LeftOutRun(run=run.name, reason=f"its result has no {wanted}") for run in without),
    )
    rows = _read_rows(used, wanted)
    asked = tuple(ALIASES.get(name, name) for name in by)
    grouped, chosen, notes = group_rows(rows, used, asked)
    grouped = grouped.assign(block=pd.Series(find_blocks(grouped, used), dtype=object))
    unit_of_analysis, unit_notes = choose_unit(grouped)
    comparison = _compare(used, grouped, wanted, chosen, unit_of_analysis)
    told = (
        *unit_notes,
        *notes,
        *_note_shared_blocks(grouped),
        *_note_campaigns(used),
        *_list_warnings(comparison),
    )
    final = comparison.model_copy(update={"warnings": told, "left_out": omitted})
    return ComparedRuns(final, grouped)


def _note_campaigns(runs: Sequence[Measured]) -> Iterable[str]:
    """Yield what has to be read with the groups of campaigns."""
    campaigns = [run for run in runs if isinstance(run, MeasuredCampaign)]
    for campaign in campaigns:
        if campaign.left:
            done = len(campaign.tasks)
            yield f"The campaign {campaign.name} is not finished: {done} of {done + campaign.left} tasks are done."
    if campaigns:
        yield (
            f"The arms of {_list_some([run.name for run in campaigns])} share their seeds. Here they count as "
            "independent; the campaign's own page has the differences of pairs, whose intervals are narrower."
        )


def _choose_quantity(runs: Sequence[Measured]) -> str:
    measuring = [run for run in runs if run.quantities]
    own = {run.measure if isinstance(run, MeasuredCampaign) else None for run in measuring}
    of_pages = [name for name in own if name is not None and len(own) == 1]
    for name in (*of_pages, *DEFAULT_QUANTITIES):
        if measuring and all(run.find_table(name) is not None for run in measuring):
            return name
    raise InputError(
        "these runs have no quantity in common that is compared by default", _hint_at_quantities(runs)
    )


def _hint_at_quantities(runs: Sequence[Measured]) -> str:
    known = list(dict.fromkeys(name for run in runs for name in run.quantities if not _is_error_bar(name)))
    if not known:
        return "none of them has measurements of trials"
    first = [name for name in DEFAULT_QUANTITIES if name in known]
    shown = [*first, *(name for name in known if name not in first)]
    more = f" and {len(shown) - _MOST_HINTED} more" if len(shown) > _MOST_HINTED else ""
    return f"name one with --quantity: {', '.join(shown[:_MOST_HINTED])}{more}"


def _is_error_bar(name: str) -> bool:
    return any(part in name for part in _INTERVALS)


def _split_by_quantity(runs: Sequence[Measured], quantity: str) -> tuple[list[Measured], list[Measured]]:
    used = [run for run in runs if quantity.rpartition(".")[2] and run.find_table(quantity) is not None]
    if runs and not used:
        known = [name for run in runs for name in run.quantities]
        near = get_close_matches(quantity, known, 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(f"no run has a quantity {quantity!r}", meant + _hint_at_quantities(runs))
    return used, [run for run in runs if run not in used]


def _read_rows(runs: Sequence[Measured], quantity: str) -> pd.DataFrame:
    """Return the measurements with the column `value`, empty where it was refused, and those of shared errors."""
    column = quantity.rpartition(".")[2]
    tables = []
    for run in runs:
        rows = run.read_measurements(run.find_table(quantity) or "")
        value = pd.to_numeric(rows[column], errors="coerce")
        if rows[column].notna().any() and value.isna().all():
            raise InputError(f"{column} is no number in {run.name}", _hint_at_quantities(runs))
        accepted = rows["left_out"].isna()
        if "accepted" in rows:
            accepted &= rows["accepted"].astype("boolean").fillna(value=False)
        tables.append(rows.assign(value=value.astype("float64").where(accepted & np.isfinite(value))))
    joined = join_measurements(tables)
    if joined.empty or joined["value"].notna().sum() == 0:
        raise InputError(
            f"no measurement of {quantity} was accepted", "labrig report shows why each was refused"
        )
    return joined.reset_index(drop=True)


def _note_shared_blocks(rows: pd.DataFrame) -> list[str]:
    """Say so where groups share blocks, so that their measurements are paired."""
    counted = rows[rows["value"].notna()]
    shared = int((counted.groupby("block")["group"].nunique() > 1).sum())
    if not shared:
        return []
    paired = "What a specimen has in common cancels in their difference; these tests do not pair, and are too cautious."
    return [f"{format_count(shared, 'specimen')} are in more than one group. {paired}"]


def _compare(
    runs: Sequence[Measured], rows: pd.DataFrame, quantity: str, by: tuple[str, ...], unit: Unit
) -> Comparison:
    names = order_groups(rows, by)
    parts = {name: rows[(rows["group"] == name) & rows["value"].notna()] for name in names}
    units = {name: _average_units(part, unit) for name, part in parts.items()}
    stem = quantity.rpartition(".")[2].rpartition("_")[0]
    shared = {name: sum_by_origin(part, units[name], stem, runs) for name, part in parts.items()}
    groups = tuple(
        _summarise(name, rows[rows["group"] == name], units[name], by, shared[name]) for name in names
    )
    tested = [name for name in names if len(units[name]) >= 2]
    samples = [list(units[name]) for name in tested]
    return Comparison(
        quantity=quantity,
        unit=_find_unit(quantity),
        by=by,
        unit_of_analysis=unit,
        groups=groups,
        welch_anova=_test_means(samples),
        pairs=_test_pairs(tested, samples, shared) if len(tested) <= MOST_GROUPS_IN_PAIRS else (),
        not_in_interval=tuple(dict.fromkeys(source for run in runs for source in run.not_in_interval)),
        settings_differ=_find_differing_settings(runs),
        warnings=(),
        used=tuple(_describe_run(run) for run in runs),
        left_out=(),
    )


def _average_units(part: pd.DataFrame, unit: Unit) -> pd.Series:
    """Return the values that n counts; of specimens, the mean of each."""
    return part.groupby("block", sort=False)["value"].mean() if unit == "specimen" else part["value"]


def _find_unit(quantity: str) -> str | None:
    found = next(
        (unit for unit in ("mm", "px", "rad", "deg", "s", "percent") if quantity.endswith(f"_{unit}")), None
    )
    return {"percent": "%"}.get(found, found) if found else None


def _summarise(
    name: str, rows: pd.DataFrame, units: "pd.Series[float]", by: Sequence[str], shared: ErrorsByOrigin
) -> Group:
    spread = compute_spread(list(units))
    counted = rows[rows["value"].notna()]
    errors = total_errors([shared])
    return Group(
        name=name,
        fields={field: str(value) for field in by if (value := rows[f"by_{field}"].iloc[0]) is not None},
        n=spread.n,
        insertions=len(counted),
        specimens=None if counted["block"].isna().any() else int(counted["block"].nunique()),
        refused=len(rows) - len(counted),
        runs=tuple(dict.fromkeys(rows["run"])),
        mean=spread.mean,
        sd=spread.sd,
        ci95=spread.ci95,
        shared_sigma=errors,
        ci95_with_shared=widen(spread.ci95, errors),
    )


def _test_means(samples: Samples) -> WelchAnova | None:
    """Return Welch's test of all groups of two or more; None if there are fewer than two, or one has no spread."""
    if len(samples) < 2 or not all(has_spread(sample) for sample in samples):
        return None
    return WelchAnova(**vars(compare_means(samples)))


def _test_pairs(
    names: Sequence[str], samples: Samples, shared: Mapping[str, ErrorsByOrigin]
) -> tuple[Pair, ...]:
    found = compare_pairs(samples) if len(samples) > 1 else {}
    pairs = []
    for i, j in combinations(range(len(names)), 2):
        test = found[i, j]
        errors = total_errors([shared[names[i]], shared[names[j]]])
        ci95 = None if test is None else test.ci95
        pairs.append(
            Pair(
                a=names[i],
                b=names[j],
                difference=float(np.mean(samples[i]) - np.mean(samples[j])),
                ci95=ci95,
                p=None if test is None else test.p,
                shared_sigma=errors,
                ci95_with_shared=widen(ci95, errors),
            )
        )
    return tuple(pairs)


def _find_differing_settings(runs: Sequence[Measured]) -> dict[str, dict[str, tuple[str, ...]]]:
    keys = dict.fromkeys(key for run in runs for key in run.settings)
    found: dict[str, dict[str, tuple[str, ...]]] = {}
    for key in keys:
        values: dict[str, tuple[str, ...]] = {}
        for run in runs:
            value = run.settings.get(key)
            text = "not stated" if value is None else str(value)
            values[text] = (*values.get(text, ()), run.name)
        if len(values) > 1:
            found[key] = values
    return found


def _describe_run(run: Measured) -> UsedRun:
    return UsedRun(
        run=run.name,
        experiment=run.experiment,
        result=run.number,
        overrides=run.overrides,
        exit_status=run.exit_status,
        verdict=run.verdict,
        simulated=run.is_simulated,
    )


def _list_warnings(comparison: Comparison) -> Iterable[str]:
    """Yield the sentences on results, runs and groups that have to be read with the numbers."""
    for key, values in comparison.settings_differ.items():
        told = "; ".join(f"{value} in {_list_some(names)}" for value, names in values.items())
        yield f"The results were measured with different settings: {key} is {told}."
    for run in comparison.used:
        yield from _warn_of_run(run)
    if len({run.simulated for run in comparison.used}) > 1:
        yield "Simulated runs and others are compared with each other."
    for group in comparison.groups:
        if group.n < 2:
            yield f"{group.name} has n = {group.n}: it is listed, but not tested."
    flat = [group.name for group in comparison.groups if group.sd is not None and group.sd == 0.0]
    if flat:
        yield f"All values are the same in {_list_some(flat)}: without a spread there is no Welch's ANOVA."
    tested = sum(group.n >= 2 for group in comparison.groups)
    if tested > MOST_GROUPS_IN_PAIRS:
        pairs = tested * (tested - 1) // 2
        yield f"{tested} groups make {pairs} pairs, left out: at most {MOST_GROUPS_IN_PAIRS} groups are paired."


def _warn_of_run(run: UsedRun) -> Iterable[str]:
    if run.overrides:
        yield f"Result {run.result} of {run.run} has settings changed after the run: {', '.join(run.overrides)}."
    if run.verdict in {"bad", "doubtful"}:
        yield f"{run.run} was judged {run.verdict}."
    if run.exit_status != "success":
        yield f"{run.run} is {run.exit_status}: what it measured is compared all the same."


def _list_some(names: Sequence[str]) -> str:
    return ", ".join(names[:3]) + (f" and {len(names) - 3} more" if len(names) > 3 else "")
