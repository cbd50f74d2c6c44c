"""Tables for a paper, in LaTeX."""

import re
from collections.abc import Sequence
from pathlib import Path

from labrig.analysis.summary import Summary, TextTable
from labrig.durable import write_atomically

_SPECIAL = {
    "\\": r"\textbackslash{}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "−": "$-$",
    "±": r"$\pm$",
    "–": "--",
    "<": "$<$",
    ">": "$>$",
    **{sign: f"\\{sign}" for sign in "&%$#_{}"},
}
_SPECIALS = re.compile("|".join(map(re.escape, _SPECIAL)))
_NUMBER = re.compile(r"[-−+]?[\d.]+( to [-−+]?[\d.]+)?|-|–")


def escape_latex(text: str) -> str:
    """Return a text whose characters LaTeX prints as they are; line ends become blanks."""
    return _SPECIALS.sub(lambda found: _SPECIAL[found[0]], " ".join(text.split()))


def make_latex_table(table: TextTable) -> str:
    r"""Return a table for the package `booktabs`; columns of numbers are aligned to the right."""
    rows = [["" if cell is None else _format_cell(cell) for cell in row] for row in table.rows]
    columns = zip(*rows, strict=True) if rows else ((),) * len(table.heads)
    aligned = "".join("r" if cells and all(map(_NUMBER.fullmatch, cells)) else "l" for cells in columns)
    lines = [_join_row(table.heads), r"\midrule", *map(_join_row, rows)]
    body = "\n".join([r"\toprule", *lines, r"\bottomrule"])
    return f"% \\usepackage{{booktabs}}\n\\begin{{tabular}}{{{aligned}}}\n{body}\n\\end{{tabular}}\n"


def _format_cell(cell: object) -> str:
    return f"{cell:.3f}" if isinstance(cell, float) else str(cell)


def _join_row(cells: Sequence[str]) -> str:
    return " & ".join(map(escape_latex, cells)) + r" \\"


def write_latex(folder: Path, summary: Summary | None) -> None:
    """Write table-1.tex ... of the summary of a result. Raises `DiskError`."""
    tables = [line for line in ([] if summary is None else summary.lines) if isinstance(line, TextTable)]
    for number, table in enumerate(tables, start=1):
        write_atomically(folder / f"table-{number}.tex", make_latex_table(table).encode())
