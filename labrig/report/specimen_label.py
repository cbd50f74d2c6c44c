"""The label of a specimen as SVG: its name as a QR code, and what a person reads beside it.

62 x 29 mm, a common size of label printers. The code holds the name alone, as text, with error correction level M
(15 % may be lost): a scanner that types gives what `labrig specimens show` takes.
"""

import unicodedata
from dataclasses import dataclass
from datetime import datetime

import segno

from labrig.protocol.specimen_file import SpecimenFile
from labrig.report.rendering import TEMPLATES, render

WIDTH_MM, HEIGHT_MM = 62, 29
_CODE_MM, _MARGIN_MM = 27.0, 1.0
_QUIET_MODULES = 4
"""ISO/IEC 18004 asks for so many light modules around a code."""
_TEXT_X_MM = _CODE_MM + 2 * _MARGIN_MM
_ROOM_MM = WIDTH_MM - _TEXT_X_MM - _MARGIN_MM
_NAME_MM, _FACT_MM = 5.0, 2.6
_MOST_CHARACTERS = 36


@dataclass(frozen=True)
class LabelLine:
    """A line of text; one that may be too long for its room is pressed together to `fit_mm`."""

    x_mm: float
    y_mm: float
    size_mm: float
    text: str
    bold: bool = False
    fit_mm: float | None = None


@dataclass(frozen=True)
class CodePlace:
    """Where a drawing stands, and how large a unit of it is [mm]."""

    left: float
    top: float
    scale: float


def draw_label(specimen: SpecimenFile) -> bytes:
    """Return the label of a specimen as an SVG file."""
    code = segno.make(specimen.name, error="m", boost_error=False, micro=False, encoding="utf-8")
    modules, _ = code.symbol_size(border=_QUIET_MODULES)
    context = {
        "name": specimen.name,
        "width_mm": WIDTH_MM,
        "height_mm": HEIGHT_MM,
        "code": code.svg_inline(border=_QUIET_MODULES, light="#fff"),
        "code_mm": CodePlace(_MARGIN_MM, _MARGIN_MM, round(_CODE_MM / modules, 5)),
        "lines": _list_lines(specimen),
    }
    return render(TEMPLATES / "label.svg.jinja", context).encode("utf-8")


def _list_lines(specimen: SpecimenFile) -> list[LabelLine]:
    curing = specimen.describe_curing()
    facts = (
        f"gelatin {specimen.gelatin_percent:g} %",
        f"batch {specimen.batch}" if specimen.batch else None,
        f"cast {_write_moment(specimen.cast_on)}",
        None if curing is None else f"cures {curing}",
        None if specimen.usable_until is None else f"use until {_write_moment(specimen.usable_until)}",
    )
    shown = [text for text in facts if text is not None]
    first = _fit(_TEXT_X_MM, 2 * _MARGIN_MM + 0.8 * _NAME_MM, _NAME_MM, specimen.name, bold=True)
    tops = (first.y_mm + (place + 1) * 1.45 * _FACT_MM + 0.6 for place in range(len(shown)))
    return [
        first,
        *(_fit(_TEXT_X_MM, round(y, 2), _FACT_MM, text) for y, text in zip(tops, shown, strict=True)),
    ]


def _write_moment(text: str) -> str:
    return datetime.fromisoformat(text).strftime("%Y-%m-%d %H:%M")


def _fit(x_mm: float, y_mm: float, size_mm: float, text: str, *, bold: bool = False) -> LabelLine:
    """Return a line that keeps to its room; of a very long text the end is left out."""
    short = text if len(text) <= _MOST_CHARACTERS else f"{text[: _MOST_CHARACTERS - 1]}…"
    needs_mm = (1.1 if bold else 1.0) * size_mm * sum(map(_estimate_em, short))
    return LabelLine(x_mm, y_mm, size_mm, short, bold, _ROOM_MM if needs_mm > _ROOM_MM else None)


def _estimate_em(character: str) -> float:
    """Return about how wide a character is, in a sans-serif that is rather wide (DejaVu Sans) [em]."""
    if unicodedata.east_asian_width(character) in {"W", "F"}:
        return 1.0
    return 0.85 if character.isupper() or character in "mw%&<>@+=" else 0.56
