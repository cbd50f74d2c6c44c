"""Errors of pydantic -> faults with a position and, of the model's JSON Schema, what the key is."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from pydantic import ValidationError

from labrig.protocol.model import ConflictError
from labrig.protocol.schema import JsonSchema
from labrig.protocol.tree import InputFault, KeyPath, Tree, choice_hint, find_closest, show, show_key

_MUST = "Input should be "
_DEEPEST = 4  # sections are not nested deeper; this bounds a recursive schema


def explain_errors(error: ValidationError, tree: Tree, schema: JsonSchema) -> tuple[InputFault, ...]:
    """Return each error of pydantic as a fault of the file that `tree` was read from.

    A missing key and an unknown key beside it that probably means it are one fault, at the unknown key. A value that
    fits none of several kinds is one fault.
    """
    spots = [_Spot(detail, _locate(detail, tree), tree, schema) for detail in error.errors(include_url=False)]
    meant = {(*spot.path[:-1], spot.guess_key()) for spot in spots if spot.kind == "extra_forbidden"}
    faults: dict[KeyPath, InputFault] = {}
    for spot in spots:
        if spot.kind != "missing" or spot.path not in meant:
            for fault in _explain(spot):
                first = faults.setdefault(fault.path, fault)
                other = fault.message.partition(" must be ")[2]
                if first is not fault and other:
                    faults[fault.path] = replace(first, message=f"{first.message} or {other}")
    return tuple(faults.values())


@dataclass(frozen=True)
class _Spot:
    """An error of pydantic, its path in the file, and the schema of the file."""

    detail: Mapping[str, Any]
    path: KeyPath
    tree: Tree
    schema: JsonSchema

    @property
    def kind(self) -> str:
        """The type of the error."""
        return str(self.detail["type"])

    @property
    def context(self) -> Mapping[str, Any]:
        """What pydantic tells of the error."""
        found: Mapping[str, Any] = self.detail.get("ctx", {})
        return found

    def find(self, around: int = 0) -> Mapping[str, Any]:
        """Return the schema of the entry, or of the section that is so many levels around it."""
        found: Mapping[str, Any] = self.schema
        loc = self.detail["loc"]
        for part in loc[: len(loc) - around]:
            found = _enter(found, part, self.schema)
        return _resolve(found, self.schema)

    @property
    def description(self) -> str:
        """What the entry is, with its unit."""
        return str(self.find().get("description", ""))

    @property
    def keys(self) -> Sequence[str]:
        """The keys of the section around it."""
        return tuple(self.find(around=1).get("properties", ()))

    def guess_key(self) -> str | None:
        """Return the key that an unknown key probably means, if possible one that the file lacks."""
        free = [key for key in self.keys if not self.tree.holds((*self.path[:-1], key))]
        return find_closest(str(self.path[-1]), free) or find_closest(str(self.path[-1]), self.keys)


def _resolve(node: Mapping[str, Any], schema: JsonSchema) -> Mapping[str, Any]:
    """Return a part of a schema with its reference, and its `or null`, resolved."""
    options = [option for option in node.get("anyOf", ()) if option != {"type": "null"}]
    if len(options) == 1:
        node = {**options[0], **{key: value for key, value in node.items() if key != "anyOf"}}
    if "$ref" not in node:
        return node
    definitions: Any = schema["$defs"]
    rest = {key: value for key, value in node.items() if key != "$ref"}
    return _resolve({**definitions[node["$ref"].rsplit("/", 1)[1]], **rest}, schema)


def _enter(node: Mapping[str, Any], part: str | int, schema: JsonSchema) -> Mapping[str, Any]:
    """Return the schema of an entry, by a part of pydantic's path, which names kinds of sections and values too."""
    node = _resolve(node, schema)
    kinds = node.get("discriminator", {}).get("mapping", {})
    if part in kinds:
        return {"$ref": kinds[part]}
    if isinstance(part, int):
        found = dict(enumerate(node.get("prefixItems", ()))).get(part, node.get("items"))
    else:
        found = node.get("properties", {}).get(part, node.get("additionalProperties"))
    return found if isinstance(found, Mapping) else node


def _locate(detail: Mapping[str, Any], tree: Tree) -> KeyPath:
    """Return the path in the file; pydantic's also names the kinds of unions, which the file does not."""
    path: KeyPath = ()
    for place, part in enumerate(detail["loc"], start=1):
        is_missing = detail["type"] == "missing" and place == len(detail["loc"])
        if is_missing or tree.holds((*path, part)):
            path = (*path, part)
    return path


def _explain(spot: _Spot) -> Iterator[InputFault]:
    path, tree, raised = spot.path, spot.tree, spot.context.get("error")
    if isinstance(raised, ConflictError):
        for conflict in raised.conflicts:
            inner = (*path, *(int(part) if part.isdecimal() else part for part in conflict.key.split(".")))
            yield InputFault(tree.at(inner), inner, conflict.message, conflict.hint)
    elif spot.kind == "extra_forbidden":
        yield _explain_unknown_key(spot)
    elif spot.kind in {"union_tag_invalid", "union_tag_not_found"}:
        kinds = spot.find()["discriminator"]
        yield choice_fault(tree, (*path, kinds["propertyName"]), tuple(kinds["mapping"]))
    elif spot.kind == "missing" and not isinstance(path[-1], int):
        yield InputFault(tree.at(path), path, f"{show_key(path[-1])} is missing", spot.description)
    else:
        yield _explain_wrong_value(spot)


def _explain_wrong_value(spot: _Spot) -> InputFault:
    path, tree, message = spot.path, spot.tree, str(spot.context.get("error") or spot.detail["msg"])
    if spot.kind == "json_invalid":  # half of a surrogate pair, from an escape or a terminal
        hint = "write the character itself, in UTF-8"
        return InputFault(tree.at(path), path, "a text holds bytes that are not characters", hint)
    around = 0
    if spot.kind == "missing":
        path, message, around = path[:-1], f"{_MUST}a list of more entries", 1
    keys = [place for place, part in enumerate(path) if isinstance(part, str)]
    name = ".".join(show_key(part) for part in path[keys[-1] :]) if keys else "the file"
    value = tree.value(path)
    must = f", must be {message.removeprefix(_MUST)}" if message.startswith(_MUST) else f": {message}"
    choices = re.findall(r"'([^']*)'", spot.context.get("expected", ""))
    told = str(spot.find(around).get("description", ""))
    hint = choice_hint(value, choices) if choices and isinstance(value, str) else told
    return InputFault(tree.at(path), path, f"{name} is {show(value)}{must}", hint)


def _explain_unknown_key(spot: _Spot) -> InputFault:
    key = str(spot.path[-1])
    elsewhere = next(_find_paths(key, spot.schema, spot.schema), None)
    if meant := spot.guess_key():
        hint = f"did you mean {meant}?"
    elif elsewhere:
        hint = f"{key} belongs to {elsewhere}; check the indentation"
    else:
        hint = "known here: " + ", ".join(spot.keys)
    return InputFault(spot.tree.at(spot.path), spot.path, f"unknown key {show_key(key)}", hint)


def _find_paths(
    key: str, node: Mapping[str, Any], schema: JsonSchema, path: tuple[str, ...] = ()
) -> Iterator[str]:
    """Yield the dotted paths of the keys of this name in a schema."""
    sections = _resolve(node, schema).get("properties", {}) if len(path) < _DEEPEST else {}
    for name, child in sections.items():
        if name == key:
            yield ".".join((*path, name))
        yield from _find_paths(key, child, schema, (*path, name))


def choice_fault(tree: Tree, path: KeyPath, choices: tuple[str, ...]) -> InputFault:
    """Return the fault of a section whose key `path[-1]` names none of `choices`, or is missing."""
    key, listed = path[-1], ", ".join(map(show_key, choices))
    if not tree.holds(path):
        hint = f"add a line such as `{key}: {choices[0]}`"
        return InputFault(tree.at(path[:-1]), path, f"{key} is missing, must be one of {listed}", hint)
    chosen = tree.value(path)
    hint = choice_hint(str(chosen), choices)
    return InputFault(tree.at(path), path, f"{key} is {show(chosen)}, must be one of {listed}", hint)
