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
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TypeAlias

from labrig.errors import InputError

Value: TypeAlias = str | int | float | bool | None
Lookup: TypeAlias = Callable[[str], Sequence[Value]]
"""From the name of a field to its values in a run."""

BLOCK_NAME = "block.name"
"""The field with the name of a specimen that has a file."""

ALWAYS_KNOWN = frozenset({"tag", "verdict", "note", BLOCK_NAME})
"""Fields that may be searched for even if no run has them."""

_MAX_DEPTH = 50
# The usual fields; a hint names these out of the two hundred that a run has.
_USUAL = (
    "run",
    "protocol",
    "exit_status",
    "started",
    "operator",
    "title",
    "seed",
    "tag",
    "verdict",
    "note",
    "gelatin_percent",
    "needle_id",
    "diameter_mm",
    "mean_radius_mm",
)
_LEAST_LIKENESS = 0.75
_COMPARISON = re.compile(
    r"""(?!(?:and|or|not)\b)([^\s=!<>~()"']+)\s*(<=|>=|!=|[=<>~])\s*("[^"]*"|'[^']*'|[^\s=!<>~()"']+)"""
)
_JOINTS = frozenset({"and", "or", "not"})
_ORDERS: dict[str, Callable[..., bool]] = {
    "=": operator.eq,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


@dataclass(frozen=True)
class Condition:
    """A parsed condition: the fields that it names with their columns in the text, from 1, and its test of a run."""

    names: tuple[tuple[str, int], ...]
    fits: Callable[[Lookup], bool]

    def require_known(self, known: Collection[str]) -> None:
        """Refuse a name that no run has. Raises `InputError`, which names its place and the existing fields."""
        for name, column in self.names:
            if not find_paths(name, known):
                raise InputError(
                    f"--where, character {column}: no run has a field {name!r}", _list_fields(name, known)
                )


def _list_fields(name: str, known: Collection[str]) -> str:
    """Return the field that was probably meant by a name that is none, and the usual ones."""
    by_depth = sorted(known, key=lambda path: (path.count("."), path))
    short = list(dict.fromkeys(path.rpartition(".")[2] for path in by_depth))
    near = [path for path in short if path.startswith(name)]
    near = near or get_close_matches(name, short, 1, _LEAST_LIKENESS)
    meant = f"did you mean {near[0]}? " if near else ""
    shown_first = [field for field in _USUAL if field in short] or short[: len(_USUAL)]
    others = len(short) - len(shown_first)
    more = f", and {others} more keys of manifest, protocol and result" if others else ""
    return f"{meant}fields: {', '.join(shown_first)}{more}"


def find_paths(name: str, known: Collection[str]) -> tuple[str, ...]:
    """Return the paths that a name matches: those that are equal to it or end in it."""
    return tuple(path for path in known if path == name or path.endswith(f".{name}"))


def parse_condition(text: str) -> Condition:
    """Read a condition. Raises `InputError`, which names the first place that makes no sense."""
    found = list(_COMPARISON.finditer(text))
    rest = _COMPARISON.sub(lambda match: " " * len(match[0]), text)
    strange = next((word for word in re.finditer(r"[^\s()]+", rest) if word[0] not in _JOINTS), None)
    if strange is not None or not found:
        raise _refuse(text, 1 if strange is None else strange.start() + 1, "this is no comparison")
    if rest.count("(") + rest.count("not") > _MAX_DEPTH:
        raise _refuse(text, 1, f"more than {_MAX_DEPTH} brackets and nots")
    tests = []
    for match in found:
        name, sign, value = match.groups()
        is_quoted = value[0] in "\"'"
        number = None if is_quoted else _parse_number(value)
        tests.append(_make_test(name, sign, value[1:-1] if is_quoted else value, number))
    numbers = iter(range(len(tests)))
    joined = " ".join(_COMPARISON.sub(lambda _: f" c{next(numbers)} ", text).split())
    try:
        fits = _join(ast.parse(joined, mode="eval").body, tests)
    except (SyntaxError, RecursionError, MemoryError) as error:
        raise _refuse(text, len(text), "and, or, not and brackets do not join the comparisons") from error
    return Condition(tuple((match[1], match.start() + 1) for match in found), fits)


def _join(node: ast.expr, tests: Sequence[Callable[[Lookup], bool]]) -> Callable[[Lookup], bool]:
    """Return the test that joined comparisons make. Raises `SyntaxError` for what is neither and, or nor not."""
    match node:
        case ast.Name(id=name):
            return tests[int(name[1:])]
        case ast.UnaryOp(op=ast.Not(), operand=operand):
            inner = _join(operand, tests)
            return lambda lookup: not inner(lookup)
        case ast.BoolOp(op=joint, values=values):
            parts, combine = (
                [_join(value, tests) for value in values],
                any if isinstance(joint, ast.Or) else all,
            )
            return lambda lookup: combine(part(lookup) for part in parts)
    raise SyntaxError


def _refuse(text: str, column: int, what: str) -> InputError:
    return InputError(
        f"--where {text!r}, character {column}: {what}",
        'for example: --where "gelatin_percent=13 and exit_status=success"; equal is one =, a number goes without its '
        "unit, a text with blanks in quotes",
    )


def _make_test(name: str, sign: str, text: str, number: float | None) -> Callable[[Lookup], bool]:
    if sign == "!=":
        equals = _make_test(name, "=", text, number)
        return lambda lookup: bool(lookup(name)) and not equals(lookup)
    if sign == "~":
        sought = text.casefold()
        return lambda lookup: any(sought in _show(value).casefold() for value in lookup(name))
    order = _ORDERS[sign]

    def fits(value: Value) -> bool:
        if value is None:  # it has no order; `=` finds it by name
            return sign == "=" and text == "null"
        if isinstance(value, int | float) and not isinstance(value, bool):
            return number is not None and order(value, number)
        return order(_show(value), text)

    return lambda lookup: any(fits(value) for value in lookup(name))


def _show(value: Value) -> str:
    """Return a value as the files have it."""
    return value if isinstance(value, str) else json.dumps(value)


def _parse_number(text: str) -> float | None:
    try:
        return float(text)
    except ValueError:
        return None
