"""Errors of pydantic -> faults with a position; what a key is stands in the model's JSON Schema."""

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from labrig.protocol.formatting import (
    Plain,
    choice_hint,
    find_closest,
    show,
    show_key,
    show_number,
)
from labrig.protocol.model import ConflictError
from labrig.protocol.schema import SchemaView
from labrig.protocol.tree import InputFault, KeyPath, Tree

_EXPECTED = {
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number, at least {ge}",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number, at most {le}",
    "finite_number": "a finite number",
    **dict.fromkeys(("float_type", "float_parsing"), "a number"),
    **dict.fromkeys(("int_type", "int_from_float", "int_parsing"), "a whole number"),
    "bool_type": "true or false",
    "string_type": "text",
    "string_too_long": "text of at most {max_length} characters",
    **dict.fromkeys(("tuple_type", "list_type"), "a list"),
    "too_long": "a list of at most {max_length} entries",
    "too_short": "a list of more entries",
    **dict.fromkeys(("model_type", "dict_type", "model_attributes_type"), "a section (keys and values)"),
    "literal_error": "{expected}",
}
"""Type of a pydantic error -> what it expects; others are told by pydantic's own message."""


@dataclass(frozen=True)
class _Spot:
    """The place of a pydantic error: the path in the file, and the schema of the place and of what is around it."""

    tree: Tree
    path: KeyPath
    view: SchemaView | None
    holder_view: SchemaView | None

    @property
    def value(self) -> Plain:
        """The value, None if the file has none."""
        return self.tree.value(self.path)

    @property
    def name(self) -> str:
        """The key as a message names it; an entry of a list follows the key of the list."""
        keys = [index for index, part in enumerate(self.path) if isinstance(part, str)]
        return ".".join(show_key(part) for part in self.path[keys[-1] :]) if keys else "the file"

    @property
    def about(self) -> str:
        """What the field is, with its unit."""
        return self.view.description if self.view else ""

    def fault(self, message: str, hint: str = "") -> InputFault:
        """Return a fault at the value, or at the key of the section that lacks it."""
        found = self.tree.at(self.path)
        return InputFault(found.value if self.tree.holds(self.path) else found.key, self.path, message, hint)


def explain_errors(error: ValidationError, tree: Tree, view: SchemaView) -> tuple[InputFault, ...]:
    """Return each error of pydantic as a fault of the file that `tree` was read from.

    A missing key and an unknown key beside it that probably means it are one fault, at the unknown key. A value that
    fits none of several kinds is one fault.
    """
    spots = [(detail, _locate(detail["loc"], tree, view)) for detail in error.errors(include_url=False)]
    meant = {
        (*spot.path[:-1], _guess_key(spot)) for detail, spot in spots if detail["type"] == "extra_forbidden"
    }
    faults: dict[KeyPath, list[InputFault]] = {}
    for detail, spot in spots:
        if detail["type"] != "missing" or spot.path not in meant:
            for fault in _explain_error(detail, spot, view):
                faults.setdefault(fault.path, []).append(fault)
    return tuple(_join(same) for same in faults.values())


def _join(faults: list[InputFault]) -> InputFault:
    """Return one fault for those of one place."""
    messages = dict.fromkeys(fault.message for fault in faults)
    first = next(iter(messages))
    others = (message.partition(", expected ")[2] for message in list(messages)[1:])
    hint = next((fault.hint for fault in faults if fault.hint), "")
    return replace(faults[0], message=" or ".join([first, *filter(None, others)]), hint=hint)


def _locate(loc: KeyPath, tree: Tree, view: SchemaView) -> _Spot:
    """Follow the location that pydantic gives; it also names the kinds of unions, which the file does not."""
    spot = _Spot(tree, (), view, view)
    for part in loc:
        if spot.view and part in spot.view.tags:
            spot = replace(spot, view=spot.view.kind(str(part)))
            continue
        path, inner = (*spot.path, part), spot.view.child(part) if spot.view else None
        if inner or tree.holds(path):
            spot = _Spot(tree, path, inner, spot.view)
    return spot


def _explain_error(detail: Mapping[str, Any], spot: _Spot, top: SchemaView) -> Iterator[InputFault]:
    kind, raised = detail["type"], detail.get("ctx", {}).get("error")
    if isinstance(raised, ConflictError):
        yield from _explain_conflicts(raised, spot)
    elif kind == "extra_forbidden":
        yield _explain_unknown_key(spot, top)
    elif kind in {"union_tag_invalid", "union_tag_not_found"}:
        key, kinds = (spot.view.tag_key, tuple(spot.view.tags)) if spot.view else ("kind", ())
        yield choice_fault(spot.tree, (*spot.path, key), kinds)
    elif kind == "missing" and not isinstance(spot.path[-1], int):
        yield spot.fault(f"{spot.name} is missing", spot.about)
    elif raised is not None:
        yield spot.fault(f"{spot.name} is {show(spot.value)}: {raised}", spot.about)
    else:
        yield _explain_wrong_value(detail, spot)


def _explain_wrong_value(detail: Mapping[str, Any], spot: _Spot) -> InputFault:
    kind, context = detail["type"], detail.get("ctx", {})
    if kind == "json_invalid":  # half of a surrogate pair, from an escape or a terminal
        return spot.fault(
            "a text holds bytes that are not characters", "write the character itself, in UTF-8"
        )
    if kind == "missing":
        spot, kind = replace(spot, path=spot.path[:-1], view=spot.holder_view), "too_short"
    limits = {key: show_number(value) for key, value in context.items() if isinstance(value, int | float)}
    expected = _EXPECTED[kind].format(**context | limits) if kind in _EXPECTED else detail["msg"]
    choices = re.findall(r"'([^']*)'", context.get("expected", ""))
    hint = choice_hint(spot.value, choices) if choices and isinstance(spot.value, str) else spot.about
    return spot.fault(f"{spot.name} is {show(spot.value)}, expected {expected}", hint)


def _explain_conflicts(raised: ConflictError, spot: _Spot) -> Iterator[InputFault]:
    for conflict in raised.conflicts:
        path = spot.path
        for part in conflict.key.split("."):
            path = (*path, int(part) if isinstance(spot.tree.value(path), list) else part)
        yield InputFault(spot.tree.at(path).value, path, conflict.message, conflict.hint)


def _guess_key(spot: _Spot) -> str | None:
    """Return the key that an unknown key probably means, if possible one that the file lacks."""
    keys = spot.holder_view.keys if spot.holder_view else ()
    free = [key for key in keys if not spot.tree.holds((*spot.path[:-1], key))]
    return find_closest(str(spot.path[-1]), free) or find_closest(str(spot.path[-1]), keys)


def _explain_unknown_key(spot: _Spot, top: SchemaView) -> InputFault:
    key = str(spot.path[-1])
    elsewhere = next(_find_paths(key, top), None)
    if meant := _guess_key(spot):
        hint = f"did you mean {meant}?"
    elif elsewhere:
        hint = f"{key} belongs to {elsewhere}; check the indentation"
    else:
        hint = "known here: " + ", ".join(spot.holder_view.keys if spot.holder_view else ())
    return InputFault(spot.tree.at(spot.path).key, spot.path, f"unknown key {show_key(key)}", hint)


def _find_paths(key: str, view: SchemaView, path: tuple[str, ...] = ()) -> Iterator[str]:
    if len(path) > 4:  # sections are not nested deeper; this bounds a recursive schema
        return
    for kind in [view.kind(tag) for tag in view.tags] or [view]:
        for name in kind.keys:
            if name == key:
                yield ".".join((*path, name))
            if child := kind.child(name):
                yield from _find_paths(key, child, (*path, name))


def choice_fault(tree: Tree, path: KeyPath, choices: tuple[str, ...]) -> InputFault:
    """Return the fault of a section whose key `path[-1]` names none of `choices`, or is missing."""
    key, listed = path[-1], ", ".join(map(show_key, choices))
    if not tree.holds(path):
        hint = f"add a line such as `{key}: {choices[0]}`"
        return InputFault(tree.at(path[:-1]).key, path, f"{key} is missing, expected one of {listed}", hint)
    chosen = tree.value(path)
    hint = choice_hint(chosen if isinstance(chosen, str) else str(chosen), choices)
    return InputFault(tree.at(path).value, path, f"{key} is {show(chosen)}, expected one of {listed}", hint)
