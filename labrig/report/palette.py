"""Colours and markers of gels, the same in every figure of a page.

Okabe and Ito, "Color universal design" (2008): people with any colour vision tell them apart. Yellow is omitted because
it is too pale on white. The marker differs too, for print in grey.
"""

from dataclasses import dataclass

_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKERS = ("o", "s", "^", "D", "v", "P", "X")

DESIGN = "#444444"


@dataclass(frozen=True)
class Mark:
    """Colour and marker of a group."""

    colour: str
    marker: str

    @property
    def rgba(self) -> int:
        """The colour, opaque, as 0xRRGGBBAA."""
        return int(self.colour.lstrip("#") + "ff", 16)


def mark(index: int) -> Mark:
    """Return the mark of the group with this number; colours repeat after seven, with other markers."""
    return Mark(_COLOURS[index % len(_COLOURS)], _MARKERS[(index + index // len(_COLOURS)) % len(_MARKERS)])
