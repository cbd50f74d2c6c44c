"""Groups of measurements by needle, gel or any other field, and what n counts in them."""

import math
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any, Literal

import numpy as np
import pandas as pd

from labrig.analysis.measurements import Measured
from labrig.errors import InputError
from labrig.record.condition import BLOCK_NAME, find_values
from labrig.text import format_count, tell_key

Unit = Literal["specimen", "insertion"]

DEFAULT_FIELDS = ("needle_id", "gelatin_percent")
ALIASES: Mapping[str, str] = {"needle": "needle_id", "gel": "gelatin_percent", "gel ratio": "gelatin_percent"}
_NO_SPECIMEN = (
    "Some pictures name no specimen. If several show insertions into the same gel, they are no independent values:"
    " intervals are then too narrow, and p too small."
)
_ONE_BLOCK = (
    "n counts insertions, which share their block of gel ({}). Intervals and p speak of these blocks "
    "alone: they do not cover how much blocks of the same ratio differ. For that, measure two blocks or more of each."
)


def group_rows(
    rows: pd.DataFrame, runs: Sequence[Measured], by: Sequence[str]
) -> tuple[pd.DataFrame, tuple[str, ...], list[str]]:
    """Put measurements into groups by the values of some fields.

    Without fields these are needle and gel. A measurement that names neither, as an imported one, is in the group of
    its run, and so are all where needle and gel are the same in all runs.

    Returns
    -------
    rows : DataFrame
        In the order of their groups, with `group`, empty for a row in none, and `block`, the block of gel, empty where
        none is named.
    by : tuple of str
        The fields.
    notes : list of str
        Sentences to be told.

    Raises
    ------
    InputError
        When a field is not known, or there is only one group.
    """
    usual = [name for name in DEFAULT_FIELDS if name in rows and rows[name].notna().any()]
    fields, notes = [ALIASES.get(name, name) for name in by] or usual or ["run"], []
    grouped = _label_rows(rows, runs, fields, whole=bool(by))
    if not by:
        grouped["group"] = grouped["group"].fillna(rows["run"])
        if len(runs) > 1 and len(_list_groups(grouped)) < 2 and usual:
            names = set(map(name_policy, runs)) - {None}
            fields = ["policy" if len(names) == len(runs) else "run"]
            if fields == ["run"] and len(names) > 1:
                notes.append("The runs have several policies: --by policy groups them.")
            grouped = _label_rows(rows, runs, fields, whole=True)
    ungrouped = int(grouped["group"].isna().sum())
    if ungrouped:
        told = format_count(ungrouped, "measurement")
        notes.append(f"No {' or '.join(fields)} is known of {told}, which are in no group.")
    if len(_list_groups(grouped)) < 2:
        raise _refuse_single_group(grouped, fields)
    return grouped.assign(block=_find_blocks(rows, runs)), tuple(fields), notes


def _label_rows(
    rows: pd.DataFrame, runs: Sequence[Measured], fields: Sequence[str], *, whole: bool
) -> pd.DataFrame:
    """Return the rows with their group, in order; `whole` names it by what is the same in all, too."""
    values = pd.concat([_find_values(rows, runs, name) for name in fields], axis=1).dropna()
    told = [i for i, count in enumerate(values.nunique()) if whole or count > 1] or range(len(fields))
    ranked = sorted(
        (tuple(map(_rank, cells)), place, ", ".join(_name_value(fields[i], cells[i]) for i in told))
        for place, cells in zip(values.index, values.to_numpy(), strict=True)
    )
    groups = pd.Series({place: name for _, place, name in ranked}, dtype=object)
    labelled = rows.assign(group=groups)
    return pd.concat([labelled.loc[groups.index], labelled.drop(groups.index)])


def _list_groups(rows: pd.DataFrame) -> list[str]:
    return list(rows.loc[rows["value"].notna(), "group"].dropna().unique())


def _rank(value: str) -> tuple[float, str]:
    """Return the sort key of a value: numbers as numbers, before texts."""
    try:
        return float(value), ""
    except ValueError:
        return math.inf, value


def _refuse_single_group(rows: pd.DataFrame, by: Sequence[str]) -> InputError:
    names, counted = _list_groups(rows), rows[rows["value"].notna()]
    what = f"there is only one group: {names[0]}" if names else f"no measurement names {' and '.join(by)}"
    if empty := sorted({*rows["group"].dropna()}.difference(names)):
        what += f"; of {', '.join(empty)} no value counts (refused, left out, or broken off on the way)"
    fields = (*DEFAULT_FIELDS, "specimen", "hole", "run")
    telling = [name for name in fields if name in rows and counted[name].nunique() > 1 and name not in by]
    others = f"--by {' or --by '.join(telling)} tells them apart, or " if telling else ""
    return InputError(f"nothing to compare: {what}", f"{others}name more runs, or a sweep of several gels")


def _find_values(rows: pd.DataFrame, runs: Sequence[Measured], name: str) -> "pd.Series[Any]":
    """Return the value of a field for each row, as text; a field of the run has that of its run."""
    if name in rows:
        return rows[name].astype(object).map(_to_text, "ignore")
    by_run = {run.name: ", ".join(_list_run_values(run, name)) or None for run in runs}
    told = {run.name: run.run.protocol[name] for run in runs if name in run.run.protocol}
    if any(isinstance(section, Mapping) for section in told.values()):
        like = {a: f"as in {min(b for b in told if told[b] == told[a])}" for a in told}
        words = {run.name: name_policy(run) for run in runs if name == "policy"}
        by_run |= words if len(set(words.values())) == len(set(like.values())) else like
    if not any(by_run.values()):
        near = get_close_matches(name, [*map(str, rows.columns), *ALIASES], 1)
        meant = f"did you mean {near[0]}? " if near else ""
        raise InputError(
            f"--by {name}: no measurement and no run has that field",
            f"{meant}fields: run, experiment, {', '.join((*DEFAULT_FIELDS, 'specimen', 'hole'))}, any other column, "
            "and the keys and sections of the protocol",
        )
    return rows["run"].astype(object).map(by_run)


def _list_run_values(run: Measured, name: str) -> list[str]:
    """Return the values of a field of manifest or protocol, each once."""
    values = find_values(run.fields, name)
    return list(dict.fromkeys(_to_text(value) for value in values if value is not None and value != ""))


def name_policy(run: Measured) -> str | None:
    """Return the policy of an insertion by the planner that it stands for; None of a run without."""
    planner = _list_run_values(run, "planner.method") if "policy" in run.run.protocol else ()
    return {"best": "default", "paper": "paper"}.get(", ".join(planner))


def _to_text(value: object) -> str:
    return f"{value:g}" if isinstance(value, float) else str(value)


def _name_value(field: str, value: str) -> str:
    if field in {"gelatin_percent", "policy"}:
        return f"{value} % gelatin" if field == "gelatin_percent" else f"{value} policy"
    value = str(int(value) + 1) if field in {"hole", "trial"} else value  # counted from 1
    return value if field in {"needle_id", "run", "specimen"} else tell_key(field, value)


def _find_blocks(rows: pd.DataFrame, runs: Sequence[Measured]) -> "pd.Series[Any]":
    """Return the block of gel of each row: a specimen of a run; empty where none is named.

    A specimen with a file is one block in all runs. Others are different blocks in different runs, whatever their
    names: no record says that one was used again. Simulated gel is drawn by seed and name, and so is one block in all
    runs of a rig that have both.
    """
    named = rows.get("specimen", pd.Series(None, rows.index)).astype(object)
    simulated = [run for run in runs if run.about.simulated]
    benches = [run for run in runs if not run.about.simulated]
    with_file = {(run.name, name) for run in benches for name in _list_run_values(run, BLOCK_NAME)}
    is_kept = np.array([pair in with_file for pair in zip(rows["run"], named, strict=True)])
    worlds = {run.name: (str(run.run.manifest.get("rig")), run.run.manifest.get("seed")) for run in simulated}
    drawn_in = {name: next(first for first in worlds if worlds[first] == worlds[name]) for name in worlds}
    return named.where(is_kept | named.isna(), rows["run"].replace(drawn_in) + "/" + named.astype(str))


def choose_unit(counted: pd.DataFrame) -> tuple[Unit, list[str]]:
    """Return what n counts, and the sentence that has to be read with it: specimens if every group has two."""
    if counted["block"].isna().any():
        return "insertion", [_NO_SPECIMEN]
    blocks = counted.groupby("group")["block"].nunique()
    if not (counted.groupby("group").size() > blocks).any():
        return "insertion", []
    if blocks.min() >= 2:
        return "specimen", []
    single = [str(name) for name, count in blocks.items() if count < 2]
    told = "; ".join(single[:4]) + ("; ..." if len(single) > 4 else "") + ": one block each"
    return "insertion", [_ONE_BLOCK.format("each group is one block" if len(single) == len(blocks) else told)]
