"""Prints results and failures: a JSON document or text for people, and errors with their hints."""

import html
import json
import math
import re
import shutil
import sys
import textwrap
from collections.abc import Mapping, Sequence
from contextlib import suppress
from contextvars import ContextVar
from dataclasses import asdict
from pathlib import Path
from types import NoneType
from typing import IO, Any

import typer

from labrig.errors import (
    CalibrationRefusedError,
    CameraError,
    ConditionMetError,
    DiskError,
    FileFormatError,
    LabrigError,
    LimitError,
    LockedError,
    MeasurementRefusedError,
    OperatorDeclinedError,
    PictureError,
    PluginError,
    Problem,
    RecordError,
    SafetyStopError,
    TargetMissedError,
    WireError,
    fault_of,
)

SPEAKS_JSON = ContextVar("SPEAKS_JSON", default=False)
"""Whether the result of the command is a JSON document (--json); otherwise it is text for people."""


# Characters that move the cursor, change colours, rename the window or turn the direction of writing, and the halves
# of characters in names that are not UTF-8. Tabs and line ends stay.
CONTROLS = re.compile(
    r"[\x00-\x08\x0b-\x1f\x7f-\x9f\u061c\u200e\u200f\u2028-\u202e\u2066-\u2069\ud800-\udfff]"
)


def escape_controls(text: str) -> str:
    r"""Return a text with its control characters written out, as `\x1b`.

    Titles, notes, tags and names of folders come from other people and could otherwise control the terminal.
    """
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def print_json(document: object) -> None:
    """Print the one JSON document of a result, unknown and infinite values as null; nothing without --json."""
    if SPEAKS_JSON.get():
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


PAGES: Mapping[type[LabrigError], str] = {
    PluginError: "extend",
    LimitError: "rig",
    PictureError: "calibrate",
    CalibrationRefusedError: "calibrate",
    MeasurementRefusedError: "calibrate",
    ConditionMetError: "protocol",
    TargetMissedError: "steer-to-target",
    WireError: "rig",
    CameraError: "rig",
    LockedError: "rig",
    DiskError: "run-format",
    RecordError: "run-format",
    SafetyStopError: "pause-and-stop",
}
"""The page of the manual that a person needs after a failure."""

PAGES_OF_FILES = (
    (r"\.json\b|^calibration\.", "calibrate"),
    (r"\bcampaign", "campaign"),
    (r"\bscenario|\b(target|obstacles)\b", "steer-to-target"),
    (r"\brig\b|calibration/", "rig"),
)
"""A pattern of a file's place, and the page that tells of it; of the others `protocol` does."""

COMMAND = ("labrig ", "ssh ")
"""How a line begins that a person copies: it is not wrapped."""
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

    def __getattr__(self, name: str) -> Any:
        return getattr(self._stream, name)

    def write(self, text: str) -> int:
        """Write, and ignore errors."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, and ignore errors."""
        with suppress(OSError):
            self._stream.flush()


def print_line(text: str, indent: int = 2) -> None:
    """Print text of a result on standard output, nothing with --json.

    A terminal gets it wrapped between words, further lines indented.
    """
    if not SPEAKS_JSON.get():
        typer.echo(_wrap(escape_controls(text), sys.stdout, indent))


def say(text: str, indent: int = 2) -> None:
    """Print a message for the person at the terminal on standard error, wrapped as `print_line` does."""
    stream = SafeStandardError()
    stream.write(f"{_wrap(escape_controls(text), sys.stderr, indent)}\n")
    stream.flush()


def _wrap(text: str, stream: IO[str], indent: int) -> str:
    if not stream.isatty():
        return text
    wrapper = textwrap.TextWrapper(
        max(shutil.get_terminal_size().columns, _LEAST_COLUMNS),
        subsequent_indent=" " * indent,
        break_long_words=False,
        break_on_hyphens=False,
    )
    return "\n".join(line if line.startswith(COMMAND) else wrapper.fill(line) for line in text.split("\n"))


def failure_document(error: LabrigError) -> dict[str, object]:
    """Return a failure as JSON: type, message and hint; for bus and drives also the fault."""
    fault = fault_of(error)
    return {
        "type": type(error).__name__,
        "message": error.message,
        "hint": error.hint or None,
        **({} if fault is None else {"fault": asdict(fault)}),
    }


def print_failure(error: LabrigError) -> None:
    """Print a failure for people on standard error, and with --json also as a document on standard output."""
    with suppress(OSError):  # if standard output itself failed, standard error alone has the message
        print_json({"error": failure_document(error)})
    say_failure(error)


def say_failure(error: LabrigError, *, is_told: bool = False) -> None:
    """Say each problem of a failure, and under it what to do; only that of one that the text of the result has told."""
    problems = (
        error.problems if isinstance(error, FileFormatError) else (Problem("", error.message, error.hint),)
    )
    for problem in problems:
        if not is_told or SPEAKS_JSON.get():
            say("error: " + ": ".join(filter(None, (problem.where, problem.message))))
        if problem.hint:
            say(f"hint: {problem.hint}")
    page = next((page for kind, page in PAGES.items() if isinstance(error, kind)), None)
    if isinstance(error, FileFormatError):
        say_page(error.problems)
    elif page is not None and not isinstance(error, OperatorDeclinedError):
        say(f"see: labrig manual {page}")


def say_page(problems: Sequence[Problem]) -> None:
    """Say which page of the manual tells of the file that the first problem is in."""
    where = problems[0].where
    page = next((page for pattern, page in PAGES_OF_FILES if re.search(pattern, where)), "protocol")
    say(f"see: labrig manual {page}")


def quote(report: str | Path) -> None:
    """Print the sentences in which a page says its result, without the links to its parts."""
    text = Path(report).read_text(encoding="utf-8")
    for sentence in re.findall(r'<(?:p|li) class="verdict">(.*?)</(?:p|li)>', text, re.DOTALL):
        print_line(" ".join(html.unescape(re.sub(r' \(<a href="#[^)]*\)|<[^>]*>', "", sentence)).split()))


def print_problems(problems: Sequence[Problem], kind: str = "") -> None:
    """Print problems that are part of a result, and under each what to do."""
    for problem in problems:
        print_line(f"{kind}{problem.where}: {problem.message}")
        if problem.hint:
            print_line(f"  hint: {problem.hint}", 4)


def print_checks(checks: Sequence[Mapping[str, Any]]) -> int:
    """Print checks (`status`, `check`, `value`, `solution`, perhaps `axis`), and return 1 if a check failed."""
    for check in checks:
        axis = f"{check['axis']} " if "axis" in check else ""
        print_line(f"{check['status']:4}  {axis}{check['check']}: {check['value']}", 6)
        if check["solution"]:
            print_line(f"      {check['solution']}", 6)
    if not any(check["status"] == "FAIL" for check in checks):
        return 0
    print_line("see: labrig manual rig")
    return 1


def print_table(heads: Sequence[str], rows: Sequence[Sequence[object]], *, cuts_last: bool = False) -> None:
    """Print a table of text, nothing with --json or without rows.

    If the terminal is too narrow for it, cut its last column if that is asked for and leaves some of it; otherwise
    print it turned, a row for each head, or else so for each row alone.
    """
    cells = [[format_cell(value) for value in row] for row in rows]
    widths = [max(map(len, column)) for column in zip(heads, *cells, strict=True)]
    room = shutil.get_terminal_size().columns if sys.stdout.isatty() else sys.maxsize
    kept = room - sum(widths[:-1]) - 2 * (len(widths) - 1)
    if cuts_last and _LEAST_COLUMNS <= kept < widths[-1]:
        cells = [[*row, last if len(last) <= kept else f"{last[: kept - 1]}…"] for *row, last in cells]
        widths[-1] = kept
    elif len(heads) > 2 and kept < widths[-1]:
        height = max(map(len, heads)) + sum(2 + max(map(len, row)) for row in cells)
        for part in [cells] if height <= room else [[row] for row in cells]:
            names, *turned = zip(heads, *part, strict=True)
            print_table(names, turned)
        return
    numeric = [bool(rows) and all(isinstance(row[i], _NUMBER) for row in rows) for i in range(len(heads))]
    columns = (f"{{:{'>' if right else '<'}{width}}}" for right, width in zip(numeric, widths, strict=True))
    line = "  ".join(columns)
    if rows and not SPEAKS_JSON.get():  # one call: there may be thousands of rows
        text = "\n".join(line.format(*row).rstrip() for row in (heads, *cells))
        typer.echo(text if room == sys.maxsize else _wrap(text, sys.stdout, 2))


def format_cell(value: object) -> str:
    """Return a value as it stands in a table, on one line; a float has three decimals."""
    if value is None:
        return _UNKNOWN
    if isinstance(value, float):
        return f"{value:.3f}"
    return escape_controls(str(value)).replace("\n", " ").replace("\t", " ")
