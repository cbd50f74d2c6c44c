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

    A missing key and an unknown key beside it that probably means it, or a file that has it, are one fault, at the
    unknown key. A value that fits none of several kinds is one fault.
    """
    spots = [_Spot(detail, tree, _Schema(schema)) for detail in error.errors(include_url=False)]
    meant = {(*spot.path[:-1], spot.guess_key()) for spot in spots if spot.kind == "extra_forbidden"}
    files = {path[:-1] for path in meant if str(path[-1]).endswith("_file")}
    faults: dict[KeyPath, InputFault] = {}
    for spot in spots:
        if spot.kind != "missing" or not (spot.path in meant or spot.path[:-1] in files):
            for fault in spot.explain():
                first = faults.setdefault(fault.path, fault)
                other = fault.message.partition(" must be ")[2]
                if first is not fault and other:
                    faults[fault.path] = replace(first, message=f"{first.message} or {other}")
    return tuple(faults.values())


@dataclass(frozen=True)
class _Schema:
    """What a JSON Schema says of entries."""

    whole: JsonSchema

    def find(self, loc: Sequence[str | int]) -> Mapping[str, Any]:
        """Return the schema of an entry, by pydantic's path, which names kinds of sections and values too."""
        node = self._resolve(self.whole)
        for part in loc:
            kinds = node.get("discriminator", {}).get("mapping", {})
            if part in kinds:
                found: Any = {"$ref": kinds[part]}
            elif isinstance(part, int):
                found = dict(enumerate(node.get("prefixItems", ()))).get(part, node.get("items"))
            else:
                found = node.get("properties", {}).get(part, node.get("additionalProperties"))
            node = self._resolve(found) if isinstance(found, Mapping) else node
        return node

    def _resolve(self, node: Mapping[str, Any]) -> Mapping[str, Any]:
        """Return a part with its reference, and its `or null`, resolved."""
        options = [option for option in node.get("anyOf", ()) if option != {"type": "null"}]
        if len(options) == 1:
            node = {**options[0], **{key: value for key, value in node.items() if key != "anyOf"}}
        if "$ref" not in node:
            return node
        definitions: Any = self.whole["$defs"]
        rest = {key: value for key, value in node.items() if key != "$ref"}
        return self._resolve({**definitions[node["$ref"].rsplit("/", 1)[1]], **rest})

    def list_paths(self, key: str, path: tuple[str, ...] = ()) -> Iterator[str]:
        """Yield the dotted paths of the keys of this name, in sections that are no list."""
        for name in self.find(path).get("properties", {}) if len(path) < _DEEPEST else ():
            if name == key:
                yield ".".join((*path, name))
            yield from self.list_paths(key, (*path, name))


class _Spot:
    """An error of pydantic: its kind, its path in the file, and what the schema says there and around it."""

    def __init__(self, detail: Mapping[str, Any], tree: Tree, schema: _Schema) -> None:
        self.kind, self.path = str(detail["type"]), _locate(detail, tree)
        self._detail, self._tree, self._schema = detail, tree, schema
        self._here, around = schema.find(detail["loc"]), schema.find(detail["loc"][:-1])
        self._around, self._keys = around, tuple(around.get("properties", ()))

    def guess_key(self) -> str | None:
        """Return the key that an unknown key probably means, if possible one that the file lacks."""
        free = [key for key in self._keys if not self._tree.holds((*self.path[:-1], key))]
        return find_closest(str(self.path[-1]), free) or find_closest(str(self.path[-1]), self._keys)

    def explain(self) -> Iterator[InputFault]:
        """Yield what is wrong."""
        path, tree, raised = self.path, self._tree, self._detail.get("ctx", {}).get("error")
        if isinstance(raised, ConflictError):
            for conflict in raised.conflicts:
                parts = (int(part) if part.isdecimal() else part for part in conflict.key.split("."))
                yield tree.fault((*path, *parts), conflict.message, conflict.hint)
        elif self.kind == "extra_forbidden":
            yield tree.fault(path, f"unknown key {show_key(path[-1])}", self._hint_at_key(str(path[-1])))
        elif self.kind in {"union_tag_invalid", "union_tag_not_found"}:
            kinds = self._here["discriminator"]
            yield choice_fault(tree, (*path, kinds["propertyName"]), tuple(kinds["mapping"]))
        elif self.kind == "missing" and isinstance(path[-1], int):
            yield self._refuse_value(path[:-1], f"{_MUST}a list of {self._around['minItems']}", self._around)
        elif self.kind == "missing":
            yield tree.fault(path, f"{show_key(path[-1])} is missing", self._here.get("description", ""))
        elif self.kind != "too_short" or len(self._detail["input"]) < self._detail["ctx"]["min_length"]:
            # pydantic does not count an entry that it has refused, and calls the list too short for it.
            yield self._refuse_value(path, str(raised or self._detail["msg"]), self._here)

    def _hint_at_key(self, key: str) -> str:
        if meant := self.guess_key():
            return f"did you mean {meant}?"
        if elsewhere := next(self._schema.list_paths(key), None):
            return f"{key} belongs to {elsewhere}; check the indentation"
        return "known here: " + ", ".join(self._keys)

    def _refuse_value(self, path: KeyPath, message: str, schema: Mapping[str, Any]) -> InputFault:
        keys = [place for place, part in enumerate(path) if isinstance(part, str)]
        name = ".".join(show_key(part) for part in path[keys[-1] :]) if keys else "the file"
        value = self._tree.value(path)
        must = f", must be {message.removeprefix(_MUST)}" if message.startswith(_MUST) else f": {message}"
        choices = re.findall(r"'([^']*)'", self._detail.get("ctx", {}).get("expected", ""))
        known = ", ".join(schema.get("properties", ())) if self.kind == "model_type" else ""
        told = " Its keys: ".join(filter(None, (schema.get("description", ""), known)))
        hint = choice_hint(value, choices) if choices and isinstance(value, str) else told
        return self._tree.fault(path, f"{name} is {show(value)}{must}", hint)


def _locate(detail: Mapping[str, Any], tree: Tree) -> KeyPath:
    """Return the path in the file; pydantic's also names the kinds of unions, which the file does not."""
    path: KeyPath = ()
    for place, part in enumerate(detail["loc"], start=1):
        is_missing = detail["type"] == "missing" and place == len(detail["loc"])
        if is_missing or tree.holds((*path, part)):
            path = (*path, part)
    return path


def choice_fault(tree: Tree, path: KeyPath, choices: tuple[str, ...], likely: str = "") -> InputFault:
    """Return the fault of a section whose key `path[-1]` names none of `choices`, or is missing: `likely` is hinted."""
    key, listed = path[-1], ", ".join(map(show_key, choices))
    if not tree.holds(path):
        message = f"{key} is missing, must be one of {listed}"
        return tree.fault(path, message, f"add a line such as `{key}: {likely or choices[0]}`")
    chosen = tree.value(path)
    hint = choice_hint(str(chosen), choices)
    return tree.fault(path, f"{key} is {show(chosen)}, must be one of {listed}", hint)
