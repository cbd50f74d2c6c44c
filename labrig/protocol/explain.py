"""Errors of pydantic -> faults with a position, in words that need no knowledge of Python.

The limits come from the model's JSON Schema, so that an editor and an error message never disagree.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from labrig.protocol.formatting import (
    Plain,
    Scalar,
    choice_hint,
    find_closest,
    number_text_hint,
    other_unit_hint,
    rescaled_hint,
    show,
    show_key,
)
from labrig.protocol.model import ConflictError
from labrig.protocol.schema import SchemaView
from labrig.protocol.tree import InputFault, KeyPath, Tree

_TRUTH_WORDS = {"yes": "true", "on": "true", "true": "true", "no": "false", "off": "false", "false": "false"}


@dataclass(frozen=True)
class _Spot:
    """The place of a pydantic error, in the file and in the schema.

    Parameters
    ----------
    tree : Tree
        The whole file.
    path : tuple of keys and indices
        From the top.
    view, holder_view : SchemaView or None
        The schema of the place and the schema of the section or list around it; None if there is none.
    """

    tree: Tree
    path: KeyPath
    view: SchemaView | None
    holder_view: SchemaView | None

    @property
    def value(self) -> Plain:
        """The value, None if the file has none."""
        return self.tree.value(self.path)

    @property
    def holder(self) -> KeyPath:
        """The path of the section or list around it."""
        return self.path[:-1]

    @property
    def name(self) -> str:
        """The key as a message names it; an entry of a list follows the key of the list."""
        keys = [index for index, part in enumerate(self.path) if isinstance(part, str)]
        return ".".join(show_key(part) for part in self.path[keys[-1] :]) if keys else "the file"

    @property
    def expected(self) -> str:
        """The expected value, in words."""
        return self.view.describe() if self.view else "another value"

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

    A missing key and an unknown key beside it that probably means it are one fault, at the unknown key.
    """
    spots = [(detail, _locate(detail["loc"], tree, view)) for detail in error.errors(include_url=False)]
    meant = {
        (*spot.holder, _guess_key(spot)) for detail, spot in spots if detail["type"] == "extra_forbidden"
    }
    return tuple(
        fault
        for detail, spot in spots
        if detail["type"] != "missing" or spot.path not in meant
        for fault in _explain_error(detail, spot, view)
    )


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
        view = spot.view
        key, kinds = (view.tag_key, tuple(view.tags)) if view else ("kind", ())
        yield choice_fault(spot.tree, (*spot.path, key), kinds)
    elif not spot.tree.holds(spot.path):
        yield _explain_missing(spot)
    else:
        yield _explain_wrong_value(spot, str(raised or ""))


def _explain_conflicts(raised: ConflictError, spot: _Spot) -> Iterator[InputFault]:
    for conflict in raised.conflicts:
        path = spot.path
        for part in conflict.key.split("."):
            path = (*path, int(part) if isinstance(spot.tree.value(path), list) else part)
        yield InputFault(spot.tree.at(path).value, path, conflict.message, conflict.hint)


def _guess_key(spot: _Spot) -> str | None:
    """Return the key that an unknown key probably means, if possible one that the file lacks."""
    keys = spot.holder_view.keys if spot.holder_view else ()
    free = [key for key in keys if not spot.tree.holds((*spot.holder, key))]
    return find_closest(str(spot.path[-1]), free) or find_closest(str(spot.path[-1]), keys)


def _explain_unknown_key(spot: _Spot, top: SchemaView) -> InputFault:
    key = str(spot.path[-1])
    elsewhere = next(_find_paths(key, top), None)
    if meant := _guess_key(spot):
        hint = f"did you mean {meant}?{other_unit_hint(key, meant, spot.value)}"
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


def _explain_missing(spot: _Spot) -> InputFault:
    if isinstance(spot.path[-1], int):  # the fault is that the list is too short
        return _explain_wrong_value(_Spot(spot.tree, spot.holder, spot.holder_view, None), "")
    return spot.fault(f"{spot.name} is missing, expected {spot.expected}", spot.about)


def _explain_wrong_value(spot: _Spot, raised: str) -> InputFault:
    if raised:
        return spot.fault(f"{spot.name} is {show(spot.value)}: {raised}", spot.about)
    hint = _value_hint(spot.name, spot.value, spot.view) if spot.view else ""
    return spot.fault(f"{spot.name} is {show(spot.value)}, expected {spot.expected}", hint or spot.about)


def _value_hint(name: str, value: Plain, view: SchemaView) -> str:
    expected = view.node.get("type")
    if isinstance(value, dict):
        return "text with a colon needs quotes" if expected == "string" else ""
    if isinstance(value, list):
        return ""
    if expected == "array":
        return "write a list: [..., ...], or a line that starts with `- ` for each entry"
    if expected in {"number", "integer"}:
        return _number_hint(name, value, view)
    return _word_hint(value, view)


def _word_hint(value: Scalar, view: SchemaView) -> str:
    expected = view.node.get("type")
    if isinstance(value, str) and view.choices:
        return choice_hint(value, view.choices)
    if isinstance(value, str) and expected == "boolean" and value.lower() in _TRUTH_WORDS:
        return f"write {_TRUTH_WORDS[value.lower()]}"
    if isinstance(value, str) or expected != "string" or view.choices:
        return ""
    return 'write "" for none, or delete the line' if value is None else "put the text in quotes"


def _number_hint(name: str, value: Scalar, view: SchemaView) -> str:
    if isinstance(value, str):
        return number_text_hint(name, value)
    if isinstance(value, bool) or value is None:
        return ""
    if view.node["type"] == "integer" and isinstance(value, float) and value.is_integer():
        return f"write {int(value)}, without a point"
    return rescaled_hint(name, value, *view.limits)
