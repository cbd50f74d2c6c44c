"""The page and the tables of a comparison, in a folder of their own."""

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from labrig.analysis.comparison import ComparedRuns, Comparison, Pair
from labrig.durable import write_atomically
from labrig.record.json_lines import encode_document
from labrig.record.tables import escape_formula
from labrig.report.comparison_figure import draw_groups, mark_groups
from labrig.report.figures import write_figure
from labrig.report.formatting import (
    UNKNOWN,
    count_decimals,
    join_words,
    number,
    signed,
    split_quantity,
)
from labrig.report.page import REPORT_FILE, TEMPLATES, tell_writing, write_page
from labrig.text import format_count

TABLE_FILES = ("measurements.csv", "measurements.json")
DOCUMENT_FILE = "comparison.json"
_SHARED_BY = {
    "lens": "by its intrinsics",
    "plane": "by its plane map",
    "surface": "by its plane map",
    "roll": "by needle and run",
    "lighting": "by its run",
}
_FIELD_NAMES = {"needle_id": "needle", "gelatin_percent": "gel"}
_LEVEL = 0.05
_MOST_NAMED = 3


@dataclass(frozen=True)
class SharedSource:
    """A source of shared errors: by what it is shared, and its standard deviation in each group, None if not known."""

    name: str
    shared_by: str
    sigmas: tuple[float | None, ...]


def write_comparison(folder: Path, compared: ComparedRuns, created: datetime) -> None:
    """Write report.html, comparison.json, measurements.csv and .json, and the figure as .svg and .pdf.

    Raises
    ------
    DiskError
        When one of them cannot be written.
    """
    content = compared.comparison
    rows = compared.table.drop(
        columns=[name for name in compared.table.columns if str(name).startswith("by_")]
    )
    first = ["group", "block", "value"]
    tidy = rows[[*first, *(name for name in rows.columns if name not in first)]]
    write_atomically(
        folder / TABLE_FILES[0], tidy.map(escape_formula).to_csv(index=False, lineterminator="\n").encode()
    )
    records = tidy.astype(object).where(tidy.notna(), None).to_dict("records")
    write_atomically(folder / TABLE_FILES[1], encode_document({"measurements": records}))
    write_atomically(folder / DOCUMENT_FILE, encode_document(content.model_dump(mode="json")))
    figure = draw_groups(content, compared.table, "groups")
    if figure is not None:
        write_figure(folder, figure)
    shown = {
        "content": content,
        "title": _make_title(content),
        "verdict": _summarise(content),
        "marks": mark_groups(content.groups),
        "figure": figure,
        "sources": _list_sources(content),
        "written": tell_writing(created),
    }
    write_page(folder / REPORT_FILE, TEMPLATES / "comparison.html.jinja", shown, _make_filters(content))


def _make_title(content: Comparison) -> str:
    by = join_words(_FIELD_NAMES.get(name, name) for name in content.by)
    return f"{split_quantity(content.quantity)[0].capitalize()} by {by}"


def _summarise(content: Comparison) -> Sequence[str]:
    """Return the result in a sentence or two: which pairs differ, by how much, and how much was measured."""
    counted = format_count(sum(group.insertions for group in content.groups), "measurement")
    whole = f"{counted} of {format_count(len(content.used), 'run')} in {format_count(len(content.groups), 'group')}."
    return _state_finding(content), whole


def _state_finding(content: Comparison) -> str:
    quantity, test = split_quantity(content.quantity)[0], content.welch_anova
    apart = [pair for pair in content.pairs if pair.p is not None and pair.p < _LEVEL]
    if apart and len(content.groups) == 2:
        (pair,) = apart
        return f"The {quantity} differs: {_state_difference(content, pair)}."
    if apart:
        told = "; ".join(_state_difference(content, pair) for pair in apart[:_MOST_NAMED])
        more = f", and {len(apart) - _MOST_NAMED} more" if len(apart) > _MOST_NAMED else ""
        return f"{len(apart)} of {len(content.pairs)} pairs differ in {quantity}: {told}{more}."
    if test is None:
        return f"The {quantity} was not tested: that takes two groups of two or more, each with a spread."
    if content.pairs:
        return f"No pair is known to differ in {quantity} (Welch's ANOVA: p {_relate_p(test.p)})."
    told = "differs" if test.p < _LEVEL else "is not known to differ"
    return f"Over all groups the mean {quantity} {told} (p {_relate_p(test.p)})."


def _state_difference(content: Comparison, pair: Pair) -> str:
    """Return by how much one group is above the other, with the 95 % interval."""
    low, high = pair.ci95 or (pair.difference, pair.difference)
    above, below = (pair.a, pair.b) if pair.difference >= 0 else (pair.b, pair.a)
    ends = (low, high) if pair.difference >= 0 else (-high, -low)
    decimals = _count_decimals(content)
    between = f"{number(ends[0], decimals)} to {number(ends[1], decimals)}"
    unit = f" {content.unit}" if content.unit else ""
    return f"{above} is {number(abs(pair.difference), decimals)}{unit} above {below} ({between})"


def _list_sources(content: Comparison) -> Sequence[SharedSource]:
    known = [group.shared_sigma for group in content.groups]
    if not any(known):
        return ()
    return [
        SharedSource(
            name, shared_by, tuple(None if sigma is None else getattr(sigma, name) for sigma in known)
        )
        for name, shared_by in _SHARED_BY.items()
    ]


def _format_p(p: float | None) -> str:
    """Return p for a cell."""
    if p is None:
        return UNKNOWN
    return "< 0.0001" if p < 0.0001 else f"{p:.4f}"


def _relate_p(p: float) -> str:
    """Return p for a sentence: `= 0.023`, or `< 0.0001`."""
    text = _format_p(p)
    return text if text.startswith("<") else f"= {text}"


def _count_decimals(content: Comparison) -> int:
    return count_decimals((group.ci95 for group in content.groups), (group.mean for group in content.groups))


def _make_filters(content: Comparison) -> dict[str, object]:
    decimals = _count_decimals(content)
    return {
        "digits": lambda value: number(value, decimals),
        "plus": lambda value: signed(value, decimals),
        "p_cell": _format_p,
        "p_value": _relate_p,
    }
