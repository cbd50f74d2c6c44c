"""What pydantic found wrong -> faults with a place, in words that need no Python.

The words come from the model's JSON Schema, so that an editor and an error message never disagree on a limit.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from labrig.protocol.model import ConflictError
from labrig.protocol.schema import SchemaView
from labrig.protocol.tree import InputFault, KeyPath, Tree
from labrig.protocol.words import (
    Plain,
    Scalar,
    choice_hint,
    closest,
    number_text_hint,
    other_unit_hint,
    rescaled_hint,
    show,
    show_key,
)

_TRUTH_WORDS = {"yes": "true", "on": "true", "true": "true", "no": "false", "off": "false", "false": "false"}


@dataclass(frozen=True)
class _Spot:
    """Where an error of pydantic stands, in the file and in the schema.

    Parameters
    ----------
    tree : Tree
        The whole file.
    path : tuple of keys and indices
        From the top.
    view, holder_view : SchemaView or None
        The schema there, and that of the section or list around it, as far as there are such.
    """

    tree: Tree
    path: KeyPath
    view: SchemaView | None
    holder_view: SchemaView | None

    @property
    def value(self) -> Plain:
        """The value there, None where there is none."""
        return self.tree.value(self.path)

    @property
    def holder(self) -> KeyPath:
        """The path of the section or list around it."""
        return self.path[:-1]

    @property
    def name(self) -> str:
        """The key as a message names it, an entry of a list after the list's key."""
        keys = [index for index, part in enumerate(self.path) if isinstance(part, str)]
        return ".".join(show_key(part) for part in self.path[keys[-1] :]) if keys else "the file"

    @property
    def words(self) -> str:
        """What is expected."""
        return self.view.words() if self.view else "another value"

    @property
    def about(self) -> str:
        """What the field is, with its unit."""
        return self.view.description if self.view else ""

    def fault(self, message: str, hint: str = "") -> InputFault:
        """Return a fault of the value there, or of the key of what should hold it."""
        found = self.tree.at(self.path)
        return InputFault(found.value if self.tree.holds(self.path) else found.key, self.path, message, hint)


def explained(error: ValidationError, tree: Tree, view: SchemaView) -> tuple[InputFault, ...]:
    """Return each error of pydantic as a fault of the file that `tree` was read from.

    A missing key for which an unknown key beside it was probably meant is one fault, told at the unknown key.
    """
    located = [(detail, _located(detail["loc"], tree, view)) for detail in error.errors(include_url=False)]
    meant = {(*spot.holder, _meant(spot)) for detail, spot in located if detail["type"] == "extra_forbidden"}
    return tuple(
        fault
        for detail, spot in located
        if detail["type"] != "missing" or spot.path not in meant
        for fault in _faults(detail, spot, view)
    )


def _located(loc: KeyPath, tree: Tree, view: SchemaView) -> _Spot:
    """Follow the location that pydantic gives; it also holds the kinds of unions, which no file has."""
    spot = _Spot(tree, (), view, view)
    for part in loc:
        if spot.view and part in spot.view.tags:
            spot = replace(spot, view=spot.view.kind(str(part)))
            continue
        path, inner = (*spot.path, part), spot.view.child(part) if spot.view else None
        if inner or tree.holds(path):
            spot = _Spot(tree, path, inner, spot.view)
    return spot


def _faults(detail: Mapping[str, Any], spot: _Spot, top: SchemaView) -> Iterator[InputFault]:
    kind, raised = detail["type"], detail.get("ctx", {}).get("error")
    if isinstance(raised, ConflictError):
        yield from _conflicts(raised, spot)
    elif kind == "extra_forbidden":
        yield _unknown_key(spot, top)
    elif kind in {"union_tag_invalid", "union_tag_not_found"}:
        view = spot.view
        key, kinds = (view.tag_key, tuple(view.tags)) if view else ("kind", ())
        yield choice_fault(spot.tree, (*spot.path, key), kinds)
    elif not spot.tree.holds(spot.path):
        yield _missing(spot)
    else:
        yield _wrong_value(spot, str(raised or ""))


def _conflicts(raised: ConflictError, spot: _Spot) -> Iterator[InputFault]:
    for conflict in raised.conflicts:
        path = spot.path
        for part in conflict.key.split("."):
            path = (*path, int(part) if isinstance(spot.tree.value(path), list) else part)
        yield InputFault(spot.tree.at(path).value, path, conflict.message, conflict.hint)


def _meant(spot: _Spot) -> str | None:
    """Return the key that an unknown one was probably meant to be, rather one that the file lacks."""
    known = spot.holder_view.keys if spot.holder_view else ()
    free = [key for key in known if not spot.tree.holds((*spot.holder, key))]
    return closest(str(spot.path[-1]), free) or closest(str(spot.path[-1]), known)


def _unknown_key(spot: _Spot, top: SchemaView) -> InputFault:
    key = str(spot.path[-1])
    elsewhere = next(_paths_to(key, top), None)
    if meant := _meant(spot):
        hint = f"did you mean {meant}?{other_unit_hint(key, meant, spot.value)}"
    elif elsewhere:
        hint = f"{key} stands at {elsewhere}; check the indentation"
    else:
        hint = "known here: " + ", ".join(spot.holder_view.keys if spot.holder_view else ())
    return InputFault(spot.tree.at(spot.path).key, spot.path, f"unknown key {show_key(key)}", hint)


def _paths_to(key: str, view: SchemaView, path: tuple[str, ...] = ()) -> Iterator[str]:
    if len(path) > 4:  # sections are not nested deeper; this bounds a schema that holds itself
        return
    for kind in [view.kind(tag) for tag in view.tags] or [view]:
        for name in kind.keys:
            if name == key:
                yield ".".join((*path, name))
            if child := kind.child(name):
                yield from _paths_to(key, child, (*path, name))


def choice_fault(tree: Tree, path: KeyPath, choices: tuple[str, ...]) -> InputFault:
    """Return the fault of a section whose key `path[-1]` names none of `choices`, or is missing."""
    key, listed = path[-1], ", ".join(map(show_key, choices))
    if not tree.holds(path):
        hint = f"add a line `{key}: {choices[0]}`"
        return InputFault(tree.at(path[:-1]).key, path, f"{key} is missing, expected one of {listed}", hint)
    chosen = tree.value(path)
    hint = choice_hint(chosen if isinstance(chosen, str) else str(chosen), choices)
    return InputFault(tree.at(path).value, path, f"{key} is {show(chosen)}, expected one of {listed}", hint)


def _missing(spot: _Spot) -> InputFault:
    if isinstance(spot.path[-1], int):  # a list that is too short is the fault of the list
        return _wrong_value(_Spot(spot.tree, spot.holder, spot.holder_view, None), "")
    return spot.fault(f"{spot.name} is missing, expected {spot.words}", spot.about)


def _wrong_value(spot: _Spot, raised: str) -> InputFault:
    if raised:
        return spot.fault(f"{spot.name} is {show(spot.value)}: {raised}", spot.about)
    hint = _value_hint(spot.name, spot.value, spot.view) if spot.view else ""
    return spot.fault(f"{spot.name} is {show(spot.value)}, expected {spot.words}", hint or spot.about)


def _value_hint(name: str, value: Plain, view: SchemaView) -> str:
    expected = view.node.get("type")
    if isinstance(value, dict):
        return "a text with a colon needs quotes" if expected == "string" else ""
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
