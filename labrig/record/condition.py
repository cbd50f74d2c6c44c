"""The language of `labrig runs --where`: comparisons of a run's fields, joined by and, or, not and brackets.

.. code-block:: text

    comparison = field ( "=" | "!=" | "<" | "<=" | ">" | ">=" | "~" ) value
    value      = a word, or any text in single or double quotes

A field with several values, such as the gels of a sweep, fits if one of them does; `a != b` is `not a = b`. If both
sides are numbers they are compared as numbers, else as text, so that ISO dates sort correctly. `~` tests whether the
text is contained, ignoring case. A run without the field does not fit.
"""

import ast
import json
import operator
import re
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from itertools import count
from types import CodeType
from typing import TypeAlias

from labrig.errors import InputError
from labrig.record.json_lines import Value

Fields: TypeAlias = Mapping[str, Sequence[Value]]
"""The values of each field of a run by its dotted path."""

BLOCK_NAME = "block.name"
"""The field with the name of a specimen that has a file."""

_USUAL = (
    "run, protocol, exit_status, started, operator, seed, tag, verdict, note, gelatin_percent, needle_id, "
    "diameter_mm, mean_radius_mm, and all other keys of manifest, protocol and result"
)
_COMPARISON = re.compile(
    r"""(?!(?:and|or|not)\b)([^\s=!<>~()"']+)\s*(<=|>=|!=|[=<>~])\s*("[^"]*"|'[^']*'|[^\s=!<>~()"']+)"""
)
_JOINING = (ast.Expression, ast.Name, ast.Load, ast.BoolOp, ast.boolop, ast.UnaryOp, ast.Not)
_ORDERS: Mapping[str, Callable[..., bool]] = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


def find_values(fields: Fields, name: str) -> list[Value]:
    """Return the values of the fields whose path is equal to a name or ends in it."""
    found = [fields[path] for path in fields if path.endswith(name) and f".{path}".endswith(f".{name}")]
    return [value for values in found for value in values]


@dataclass(frozen=True)
class Comparison:
    """A comparison of a field with a text, or with the number that it is; `column` is its place, from 1."""

    name: str
    sign: str
    text: str
    number: float | None
    column: int

    def fits(self, values: Sequence[Value]) -> bool:
        """Return whether one of the field's values fits."""
        if self.sign == "!=":
            return bool(values) and not replace(self, sign="=").fits(values)
        return any(self._fits_one(value) for value in values)

    def _fits_one(self, value: Value) -> bool:
        shown = value if isinstance(value, str) else json.dumps(value)
        if self.sign == "~":
            return self.text.casefold() in shown.casefold()
        if value is None:  # it has no order; `=` finds it by name
            return self.sign == "=" and self.text == "null"
        if isinstance(value, int | float) and not isinstance(value, bool):
            return self.number is not None and _ORDERS[self.sign](value, self.number)
        return _ORDERS[self.sign](shown, self.text)

    def refuse(self, known: Collection[str]) -> InputError:
        """Return the error of a field that no run has; names the one that was probably meant."""
        near = get_close_matches(self.name, sorted({path.rpartition(".")[2] for path in known}), 1, 0.75)
        meant = f"did you mean {near[0]}? " if near else ""
        message = f"--where, character {self.column}: no run has a field {self.name!r}"
        return InputError(message, f"{meant}fields: {_USUAL}")


@dataclass(frozen=True)
class Condition:
    """A parsed condition: its comparisons, and the expression that joins them by the names c0, c1 ..."""

    comparisons: tuple[Comparison, ...]
    joined: CodeType

    def fits(self, fields: Fields) -> bool:
        """Return whether a run with these fields fits."""
        held = {
            f"c{number}": comparison.fits(find_values(fields, comparison.name))
            for number, comparison in enumerate(self.comparisons)
        }
        # It holds nothing but these names, and, or and not: `parse_condition` has looked at every node.
        return bool(eval(self.joined, {"__builtins__": {}}, held))  # noqa: S307


def parse_condition(text: str) -> Condition:
    """Read a condition. Raises `InputError`, which names the first place that makes no sense."""
    comparisons = tuple(_read_comparison(match) for match in _COMPARISON.finditer(text))
    rest = _COMPARISON.sub(lambda match: " " * len(match[0]), text)
    strange = re.search(r"(?!(?:and|or|not)(?![^\s()]))(?<![^\s()])[^\s()]+", rest)
    if strange is not None or not comparisons:
        raise _refuse(text, 1 if strange is None else strange.start() + 1, "this is no comparison")
    numbers = count()
    joined = " ".join(_COMPARISON.sub(lambda _: f" c{next(numbers)} ", text).split())
    try:
        tree = ast.parse(joined, mode="eval")
        if all(isinstance(node, _JOINING) for node in ast.walk(tree)):
            return Condition(comparisons, compile(tree, "--where", "eval"))
    except (SyntaxError, RecursionError, MemoryError):
        pass
    raise _refuse(text, len(text), "and, or, not and brackets do not join the comparisons")


def _read_comparison(match: re.Match[str]) -> Comparison:
    name, sign, value = match.groups()
    if value[0] in "\"'":
        return Comparison(name, sign, value[1:-1], None, match.start() + 1)
    try:
        return Comparison(name, sign, value, float(value), match.start() + 1)
    except ValueError:
        return Comparison(name, sign, value, None, match.start() + 1)


def _refuse(text: str, column: int, what: str) -> InputError:
    return InputError(
        f"--where {text!r}, character {column}: {what}",
        'for example: --where "gelatin_percent=13 and exit_status=success"; equal is one =, a number goes without its '
        "unit, a text with blanks in quotes",
    )
