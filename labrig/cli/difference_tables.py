"""Prints the differences of two runs as tables."""

from collections.abc import Sequence
from itertools import groupby

from labrig.cli.output import print_line, print_table
from labrig.record.difference import Difference, group_differences

_LONGEST_CELL = 24
_LONGEST_SECTION = 15
"""Differences of a section that are printed one by one; of more, those in lists are summed up. --json has all."""


def print_differences(differences: Sequence[Difference]) -> None:
    """Print the differences, a table or two for each section."""
    if not differences:
        print_line("no difference")
    for section, group in groupby(differences, key=lambda difference: difference.section):
        _print_section(section, list(group))


def _print_section(section: str, differences: Sequence[Difference]) -> None:
    """Print the differences of a section; of a long one, those of a list's items together."""
    groups = group_differences(differences)
    if len(differences) <= _LONGEST_SECTION:
        single, several = list(differences), []
    else:
        single = [group.first for group in groups if group.count == 1]
        several = [group for group in groups if group.count > 1]
    if single:
        rows = [[found.key, _shorten(found.a), _shorten(found.b)] for found in single]
        print_table((section, "A", "B"), rows)
        print_line("")
    if several:
        sums = [
            [group.key, group.count, _format_size(group.mean), _format_size(group.largest)]
            for group in several
        ]
        print_table((f"{section}, in lists", "differ", "by on average", "by at most"), sums)
        print_line("")


def _format_size(value: float | None) -> str | None:
    return None if value is None else f"{value:.4g}"


def _shorten(value: object) -> str | None:
    """Return a value shortened, with enough digits to tell it from another."""
    if isinstance(value, float):
        return f"{value:.9g}"
    text = None if value is None else str(value)
    return text if text is None or len(text) <= _LONGEST_CELL else f"{text[: _LONGEST_CELL - 3]}..."
