"""Prints results and failures: a JSON document or text for people, and errors with their hints."""

import json
import math
import os
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict
from types import NoneType
from typing import IO, Annotated, Any, TypeVar

import typer

from labrig.errors import FileFormatError, LabrigError, fault_of

_T = TypeVar("_T")

AsJson = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]


# Characters that move the cursor, change colours, rename the window or turn the direction of writing, and the halves
# of characters in names that are not UTF-8. Tabs and line ends stay.
CONTROLS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def escape_controls(text: str) -> str:
    r"""Return a text with its control characters written out, as `\x1b`.

    Titles, notes, tags and names of folders come from other people and could otherwise control the terminal.
    """
    if text.isprintable():
        return text
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def show(document: _T, as_json: bool, print_text: Callable[[_T], None]) -> None:
    """Print a result: as JSON, or as text for people."""
    if as_json:
        print_json(document)
    else:
        print_text(document)


def print_json(document: object) -> None:
    """Print one JSON document, in which unknown and infinite values are null."""
    text = json.dumps(_make_finite(document), indent=2, ensure_ascii=False, allow_nan=False)
    typer.echo(CONTROLS.sub(lambda found: f"\\u{ord(found[0]):04x}", text))


def _make_finite(value: object) -> object:
    match value:
        case float():
            return value if math.isfinite(value) else None
        case Mapping():
            return {key: _make_finite(item) for key, item in value.items()}
        case list() | tuple():
            return [_make_finite(item) for item in value]
    return value


_UNKNOWN = "-"
_LEAST_COLUMNS = 20
_NUMBER = (int, float, NoneType)


class SafeStandardError:
    """Standard error without errors if its reader has gone.

    A log, a pipe or a terminal that has gone must not end a run with a needle in tissue. The stream is fixed when this
    is made: a progress bar takes the place of `sys.stderr`, and what the bar writes must not come back to it.

    Its base is none of `io`: those flush in a finaliser, in which Python drops what the handler of a signal raises.
    """

    def __init__(self) -> None:
        self._stream = sys.stderr

    @property
    def encoding(self) -> str | None:
        """The encoding, by which it is chosen what a bar is drawn with; None if it is not known."""
        return self._stream.encoding

    def write(self, text: str) -> int:
        """Write, and ignore errors."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, and ignore errors."""
        with suppress(OSError):
            self._stream.flush()

    def isatty(self) -> bool:
        """Return whether it is a terminal."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Return the descriptor, from which the width of a terminal is read."""
        return self._stream.fileno()


def print_line(text: str, indent: int = 2) -> None:
    """Print text of a result on standard output; a terminal gets it wrapped between words, further lines indented."""
    typer.echo(_wrap(escape_controls(text), sys.stdout, indent))


def say(text: str, indent: int = 2) -> None:
    """Print a message for the person at the terminal on standard error, wrapped as `print_line` does."""
    stream = SafeStandardError()
    stream.write(f"{_wrap(escape_controls(text), sys.stderr, indent)}\n")
    stream.flush()


def _wrap(text: str, stream: IO[str], indent: int) -> str:
    if not stream.isatty():
        return text
    columns = max(_count_columns(stream), _LEAST_COLUMNS)
    return "\n".join(
        textwrap.fill(
            line, columns, subsequent_indent=" " * indent, break_long_words=False, break_on_hyphens=False
        )
        for line in text.split("\n")
    )


def _count_columns(stream: IO[str]) -> int:
    """Return the width of a terminal, `COLUMNS` first; standard error may be one where standard output is none."""
    if os.environ.get("COLUMNS", "").isdecimal():
        return int(os.environ["COLUMNS"])
    try:
        return os.get_terminal_size(stream.fileno()).columns
    except (OSError, ValueError):
        return shutil.get_terminal_size().columns


def ring_bell() -> None:
    """Ring the bell of the terminal of standard error, if it is one."""
    stream = SafeStandardError()
    if stream.isatty():
        stream.write("\a")
        stream.flush()


def failure_document(error: LabrigError) -> dict[str, object]:
    """Return a failure as JSON: type, message and hint; for bus and drives also the fault."""
    document: dict[str, object] = {
        "type": type(error).__name__,
        "message": error.message,
        "hint": error.hint or None,
    }
    fault = fault_of(error)
    return document if fault is None else {**document, "fault": asdict(fault)}


def print_failure(error: LabrigError, as_json: bool) -> None:
    """Print a failure for people on standard error, and with --json also as a document on standard output."""
    if as_json:
        # If standard output itself failed, standard error alone has the message.
        with suppress(OSError):
            print_json({"error": failure_document(error)})
    for line in failure_lines(error):
        say(line)


def failure_lines(error: LabrigError) -> list[str]:
    """Return the lines that report a failure: each problem, and under it what to do."""
    if not isinstance(error, FileFormatError):
        return [f"error: {error.message}", *([f"hint: {error.hint}"] if error.hint else [])]
    lines = []
    for problem in error.problems:
        lines.append(f"error: {problem.where}: {problem.message}")
        if problem.hint:
            lines.append(f"hint: {problem.hint}")
    return lines


def print_checks(checks: Sequence[Mapping[str, Any]], as_json: bool) -> int:
    """Print checks (`status`, `check`, `value`, `solution`, perhaps `axis`), and return 1 if a check failed."""
    show(checks, as_json, _print_checks)
    return 1 if any(check["status"] == "FAIL" for check in checks) else 0


def _print_checks(checks: Sequence[Mapping[str, Any]]) -> None:
    for check in checks:
        axis = f"{check['axis']} " if "axis" in check else ""
        print_line(f"{check['status']:4}  {axis}{check['check']}: {check['value']}", 6)
        if check["solution"]:
            print_line(f"      {check['solution']}", 6)


def print_table(heads: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    """Print a table; if the terminal is too narrow for it, a block of `head: value` for each row."""
    cells = [[format_cell(value) for value in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    if sys.stdout.isatty() and sum(widths) + 2 * (len(widths) - 1) > _count_columns(sys.stdout):
        for name, *others in cells:
            print_line(f"{heads[0]}: {name}" if heads[0] else name)
            known = [
                f"{head}: {cell}" for head, cell in zip(heads[1:], others, strict=True) if cell != _UNKNOWN
            ]
            print_line(f"  {', '.join(known)}")
        return
    numeric = [bool(rows) and all(isinstance(row[i], _NUMBER) for row in rows) for i in range(len(heads))]
    columns = (f"{{:{'>' if right else '<'}{width}}}" for right, width in zip(numeric, widths, strict=True))
    line = "  ".join(columns)
    # One call: there may be thousands of rows.
    typer.echo("\n".join(line.format(*row).rstrip() for row in (heads, *cells)))


def format_cell(value: object) -> str:
    """Return a value as it stands in a table, on one line; a float has three decimals."""
    if value is None:
        return _UNKNOWN
    if isinstance(value, float):
        return f"{value:.3f}"
    return escape_controls(str(value)).replace("\n", " ").replace("\t", " ")
