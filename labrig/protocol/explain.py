"""What pydantic found wrong -> faults with a place, in words that need no Python.

The words come from the model's JSON Schema, so that an editor and an error message never disagree on a limit.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from labrig.protocol.model import ConflictError
from labrig.protocol.schema import SchemaView
from labrig.protocol.tree import Fault, KeyPath, Node, Place, Scalar
from labrig.protocol.words import (
    choice_hint,
    closest,
    number_text_hint,
    other_unit_hint,
    rescaled_hint,
    show_key,
)

_TRUTH_WORDS = {"yes": "true", "on": "true", "true": "true", "no": "false", "off": "false", "false": "false"}


@dataclass(frozen=True)
class _Spot:
    """Where an error of pydantic stands, in the file and in the schema.

    Parameters
    ----------
    path : tuple of keys and indices
        From the top.
    node, view : Node, SchemaView or None
        The value there and its schema, as far as there are such.
    holder, holder_view : Node, SchemaView or None
        The innermost section or list of the file on the way there, and its schema.
    """

    path: KeyPath
    node: Node | None
    view: SchemaView | None
    holder: Node
    holder_view: SchemaView | None

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

    def fault(self, message: str, hint: str = "", place: Place | None = None) -> Fault:
        """Return a fault of this spot; without `place` it stands at the value, or at what should hold it."""
        nearest = self.node.place if self.node else self.holder.key
        return Fault(place or nearest, self.path, message, hint)


def explained(error: ValidationError, root: Node, view: SchemaView) -> tuple[Fault, ...]:
    """Return each error of pydantic as a fault of the file that `root` was read from.

    A missing key for which an unknown key beside it was probably meant is one fault, told at the unknown key.
    """
    located = [(detail, _located(detail["loc"], root, view)) for detail in error.errors(include_url=False)]
    meant = {
        (*spot.path[:-1], _meant(spot)) for detail, spot in located if detail["type"] == "extra_forbidden"
    }
    return tuple(
        fault
        for detail, spot in located
        if detail["type"] != "missing" or spot.path not in meant
        for fault in _faults(detail, spot, view)
    )


def _located(loc: KeyPath, root: Node, view: SchemaView) -> _Spot:
    """Follow the location that pydantic gives; it also holds the kinds of unions, which no file has."""
    spot = _Spot((), root, view, root, view)
    for part in loc:
        if spot.view and part in spot.view.tags:
            kind = spot.view.kind(str(part))
            spot = _Spot(spot.path, spot.node, kind, spot.holder, spot.holder_view)
            continue
        child = spot.node.children.get(part) if spot.node else None
        child_view = spot.view.child(part) if spot.view else None
        if child or child_view:
            spot = _Spot((*spot.path, part), child, child_view, spot.node or spot.holder, spot.view)
    return spot


def _faults(detail: Mapping[str, Any], spot: _Spot, top: SchemaView) -> Iterator[Fault]:
    kind, raised = detail["type"], detail.get("ctx", {}).get("error")
    if isinstance(raised, ConflictError):
        yield from _conflicts(raised, spot)
    elif kind == "extra_forbidden":
        yield _unknown_key(spot, top)
    elif kind in {"union_tag_invalid", "union_tag_not_found"}:
        yield _unknown_kind(spot)
    elif spot.node is None:
        yield _missing(spot)
    else:
        yield _wrong_value(spot, spot.node, str(raised or ""))


def _conflicts(raised: ConflictError, spot: _Spot) -> Iterator[Fault]:
    for conflict in raised.conflicts:
        node, path = spot.node or spot.holder, spot.path
        for part in conflict.key.split("."):
            key = int(part) if node.kind == "sequence" else part
            node, path = node.children.get(key, node), (*path, key)
        yield Fault(node.place, path, conflict.message, conflict.hint)


def _meant(spot: _Spot) -> str | None:
    """Return the key that an unknown one was probably meant to be, rather one that the file lacks."""
    known = spot.holder_view.keys if spot.holder_view else ()
    free = [key for key in known if key not in spot.holder.children]
    return closest(str(spot.path[-1]), free) or closest(str(spot.path[-1]), known)


def _unknown_key(spot: _Spot, top: SchemaView) -> Fault:
    key, node = str(spot.path[-1]), spot.node or spot.holder
    elsewhere = next(_paths_to(key, top), None)
    if meant := _meant(spot):
        hint = f"did you mean {meant}?{other_unit_hint(key, meant, node.scalar)}"
    elif elsewhere:
        hint = f"{key} stands at {elsewhere}; check the indentation"
    else:
        hint = "known here: " + ", ".join(spot.holder_view.keys if spot.holder_view else ())
    return spot.fault(f"unknown key {show_key(key)}", hint, node.key)


def _paths_to(key: str, view: SchemaView, path: tuple[str, ...] = ()) -> Iterator[str]:
    if len(path) > 4:  # sections are not nested deeper; this bounds a schema that holds itself
        return
    for name in view.keys:
        if name == key:
            yield ".".join((*path, name))
        if child := view.child(name):
            yield from _paths_to(key, child, (*path, name))


def _unknown_kind(spot: _Spot) -> Fault:
    view, node = spot.view, spot.node or spot.holder
    key, kinds = (view.tag_key, tuple(view.tags)) if view else ("kind", ())
    return choice_fault(node, (*spot.path, key), kinds)


def choice_fault(section: Node, path: KeyPath, choices: tuple[str, ...]) -> Fault:
    """Return the fault of a section whose key `path[-1]` names none of `choices`, or is missing."""
    key, chosen = path[-1], section.children.get(path[-1])
    listed = ", ".join(map(show_key, choices))
    if chosen is None:
        hint = f"add a line `{key}: {choices[0]}`"
        return Fault(section.key, path, f"{key} is missing, expected one of {listed}", hint)
    message = f"{key} is {chosen.shown()}, expected one of {listed}"
    return Fault(chosen.place, path, message, choice_hint(str(chosen.scalar), choices))


def _missing(spot: _Spot) -> Fault:
    if isinstance(spot.path[-1], int):  # a list that is too short is the fault of the list
        whole = _Spot(spot.path[:-1], spot.holder, spot.holder_view, spot.holder, spot.holder_view)
        return _wrong_value(whole, spot.holder, "")
    return spot.fault(f"{spot.name} is missing, expected {spot.words}", spot.about, spot.holder.key)


def _wrong_value(spot: _Spot, node: Node, raised: str) -> Fault:
    if raised:
        return spot.fault(f"{spot.name} is {node.shown()}: {raised}", spot.about)
    hint = _value_hint(spot.name, node, spot.view) if spot.view else ""
    return spot.fault(f"{spot.name} is {node.shown()}, expected {spot.words}", hint or spot.about)


def _value_hint(name: str, node: Node, view: SchemaView) -> str:
    expected = view.node.get("type")
    if node.kind == "mapping" and expected == "string":
        return "a text with a colon needs quotes"
    if node.kind != "scalar":
        return ""
    if expected == "array":
        return "write a list: [..., ...], or a line that starts with `- ` for each entry"
    if expected in {"number", "integer"}:
        return _number_hint(name, node.scalar, view)
    return _word_hint(node.scalar, view)


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
