"""Tables and the paragraph on methods for a paper, in LaTeX and as plain text."""

import re
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from labrig import __version__
from labrig.analysis.result import AnyResult
from labrig.analysis.summary import Summary, TextTable
from labrig.durable import write_atomically
from labrig.errors import InputError
from labrig.record.manifest import is_simulated
from labrig.record.reader import Run
from labrig.record.seal import find_root
from labrig.report.calibration_rows import describe_calibration
from labrig.report.formatting import UNKNOWN, flatten, format_time
from labrig.report.provenance import describe_code

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
_NO_SETTING = frozenset({"schema_version", "title", "operator", "notes", "experiment"})


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


def write_latex(folder: Path, run: Run, result: AnyResult | None, summary: Summary | None) -> None:
    """Write table-1.tex ... of the summary of a result, methods.tex and methods.txt. Raises `DiskError`."""
    tables = [line for line in ([] if summary is None else summary.lines) if isinstance(line, TextTable)]
    for number, table in enumerate(tables, start=1):
        write_atomically(folder / f"table-{number}.tex", make_latex_table(table).encode())
    sentences = list_methods(run, result)
    write_atomically(folder / "methods.txt", (" ".join(sentences) + "\n").encode())
    write_atomically(folder / "methods.tex", ("\n".join(map(escape_latex, sentences)) + "\n").encode())


def list_methods(run: Run, result: AnyResult | None) -> list[str]:
    """Return how a run was made and measured, with every setting, as sentences."""
    manifest, protocol = run.manifest, run.protocol
    title = str(protocol.get("title") or "").strip()
    name = f"{run.path.name} ({title})" if title else run.path.name
    code = describe_code(manifest.get("provenance"))
    recorded = f"recorded on {format_time(manifest.get('started'))} with {code}{_name_kind(run)}"
    sentences = [f"Run {name}, experiment {manifest.get('experiment')}, was {recorded}."]
    root = find_root(run.path)
    if root:
        sentences.append(f"The root of its record is {root}.")
    settings = [row for row in flatten(protocol) if row[0] not in _NO_SETTING and row[1] != UNKNOWN]
    sentences.append(f"It had these settings: {_join_settings(settings)}.")
    if result is not None:
        sentences += _list_measurement(run, result)
    sentences.append(f"This paragraph was written by labrig {__version__}.")
    return sentences


def _list_measurement(run: Run, result: AnyResult) -> list[str]:
    content = result.content
    changed = ", ".join(content.overrides)
    how = f"settings changed after the run ({changed})" if changed else "the settings of the run"
    code = describe_code(content.provenance)
    sentences = [
        f"Result {int(result.path.name)} was computed on {format_time(content.created)} with {code}, by {how}."
    ]
    if content.settings:
        sentences.append(f"The measurement had these settings: {_join_settings(flatten(content.settings))}.")
    with suppress(InputError):  # a run without a map of the plane
        sentences.append(f"The calibration: {_join_settings(describe_calibration(run))}.")
    if any("ci95" in name for table in content.tables.values() for name in table.model.model_fields):
        sentences.append(
            "Intervals are at 95 %; that of a mean is Student's, from the sample standard deviation, and then widened "
            "for the roll of the bevel where a standard deviation of it is among the settings."
        )
    return sentences


def _name_kind(run: Run) -> str:
    return ", on a simulated rig" if is_simulated(run.manifest) else ""


def _join_settings(rows: Sequence[tuple[str, str]]) -> str:
    return "; ".join(f"{name} {value.rstrip('.')}" for name, value in rows)
