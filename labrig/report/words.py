"""Numbers and lists as the pages print them."""

from collections.abc import Iterable, Mapping, Sequence

from markupsafe import Markup, escape

UNKNOWN = "–"
_MINUS = "−"

Rows = tuple[tuple[str, str], ...]
"""Terms, and what is said of each."""


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with its digits and a true minus sign, or a dash where it is unknown."""
    return UNKNOWN if value is None else f"{value:.{digits}f}".replace("-", _MINUS)


def signed(value: float | None, digits: int = 3) -> str:
    """Return a difference with its sign; one that rounds to zero has none."""
    return UNKNOWN if value is None else f"{value:+z.{digits}f}".replace("-", _MINUS)


def moment(value: object) -> str:
    """Return a recorded calendar time, `2026-11-21T09:30:00+00:00`, as people read it."""
    return shown(value).replace("T", " ").replace("+00:00", " UTC")


def interval(value: Sequence[float] | None, digits: int = 2) -> str:
    """Return an interval as `low to high`."""
    return UNKNOWN if value is None else f"{number(value[0], digits)} to {number(value[1], digits)}"


def count_of(count: int, noun: str) -> str:
    """Return a count with its noun, in the plural where it needs one."""
    return f"{count} {noun}" if count == 1 else f"{count} {noun}s"


def joined(words: Iterable[str]) -> str:
    """Return words as people list them: `a, b and c`."""
    listed = list(words)
    return " and ".join([", ".join(listed[:-1]), listed[-1]]) if len(listed) > 1 else "".join(listed)


def flattened(value: object, path: str = "") -> list[tuple[str, str]]:
    """Return what a nested document says as rows: dotted key, value."""
    if isinstance(value, Mapping):
        return [
            row
            for key, inner in value.items()
            for row in flattened(inner, f"{path}.{key}" if path else str(key))
        ]
    if isinstance(value, list | tuple) and any(isinstance(item, Mapping | list | tuple) for item in value):
        return [row for i, inner in enumerate(value) for row in flattened(inner, f"{path}[{i}]")]
    if isinstance(value, list | tuple):
        return [(path, ", ".join(map(shown, value)) or UNKNOWN)]
    return [(path, shown(value))]


def breakable(key: str) -> Markup:
    """Return a dotted key as HTML in which a line may end after a dot or an underscore, and not in a word."""
    return escape(key).replace(".", Markup(".<wbr>")).replace("_", Markup("_<wbr>"))


def shown(value: object) -> str:
    """Return one value as text: a dash for none, yes and no, six digits of a number."""
    if value is None or value == "":
        return UNKNOWN
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:.6g}".replace("-", _MINUS) if isinstance(value, float) else str(value)
